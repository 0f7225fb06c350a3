"""The figures in words, for the stage's README."""

from benchmarks.unet.contenders import BATCH, Figures


def table(report: Figures) -> str:
    """What the stage's README says of these figures."""
    lines = [
        f"{report['machine']['processor']}, one thread, CPU seconds of a step (`make bench-unet`). The ratio is ours",
        "over diffusers' UNet2DModel of as many parameters behind the same packing of pixels:",
    ]
    lines += ["", "| step | how | ours | UNet2DModel | packed | ratio to packed |", "|---|---|---|---|---|---|"]
    for part in ("training", "denoising"):
        for kind, row in report.get(part, {}).items():
            s = row["cpu_s"]
            lines.append(
                f"| {part} | {kind} | {s['ours']:.3f} | {s['peer']:.3f} | {s['peer_packed']:.3f} "
                f"| {row['over_peer_packed']:.2f} |"
            )
    if "decoding" in report:
        share, cost = report["decoding"]["waited_share"], report["decoding"]["batch_cpu_ms"]
        lines += ["", f"Training waited for pictures of 720 x 1280 for {share:.1%} of its time."]
        lines += [f"Decoding and cutting {BATCH} of them takes {cost:.0f} CPU ms."]
    if "learning" in report:
        losses = ", ".join(
            f"{name} {report['learning'][key]['held_out_loss']:.3f}"
            for key, name in (("ours", "ours"), ("peer", "UNet2DModel"), ("peer_packed", "packed"))
        )
        lines += ["", f"Held-out loss after {report['learning']['cpu_s']:.0f} CPU seconds of training each: {losses}."]
    if "paper" in report:
        p = report["paper"]
        lines += [
            "",
            f"The paper's configuration (256 pixels, D7) has {p['parameters']:,} parameters. On one picture of "
            f"{p['picture']} pixels its forward pass takes {p['forward_cpu_s']:.1f} CPU seconds and a training step "
            f"{p['training_step_cpu_s']:.1f}, in {p['peak_memory_mib'] / 1024:.1f} GiB.",
        ]
    return "\n".join(lines)
