"""What a reader should know before trusting the figures: fixed limits, and whatever came out weak in this run."""

from collections.abc import Sequence

from inpaint3d.contracts.models.artifacts import MaskSet, Metric, Protocol
from inpaint3d.stages.evaluation import prior
from inpaint3d.stages.evaluation import protocol_names as names

CONTROL = "continued-reconstruction"  # the label of a field that took the same steps without a prior

VISIBLY_APART = 0.1  # LPIPS between two completions

LIMITS = (
    "What is behind the mask was made up. Several fillings can be right; PSNR and SSIM favour the blurred "
    "average of them, LPIPS and the pictures say more.",
    "FD-lite0 and KID-lite0 use EfficientNet-Lite0's features, since Inception's weights come with no "
    "package: they are not FID and KID, and must not be compared with published figures.",
)


def list_weaknesses(first: str, done: Sequence[Protocol], masks: MaskSet, *, truth: bool) -> list[str]:
    """Sentences on what is weak for the method `first`, and on what could not be told."""
    found: list[str] = []
    box = _collect_values(done, names.BOX, "psnr")
    if names.MEAN_SURROUND in box and first in box and box[first] <= box[names.MEAN_SURROUND]:
        found.append(
            f"Weak: {first} does not beat a hole filled with the mean colour of its surround "
            f"({box[first]:.2f} against {box[names.MEAN_SURROUND]:.2f} dB)."
        )
    perceived = _collect_values(done, names.BOX, "lpips_vgg")
    if CONTROL in perceived and first != CONTROL and perceived[first] >= perceived[CONTROL]:
        found.append(
            f"Weak: by LPIPS {first} adds nothing to the same steps of {CONTROL}: {perceived[first]:.3f} "
            f"against {perceived[CONTROL]:.3f} (PSNR {box[first]:.2f} against {box[CONTROL]:.2f} dB)."
        )
    known = _collect_values(done, names.HELD_OUT, "psnr")
    for baseline in (names.MEAN_COLOUR, names.WARPED):
        if baseline in known and first in known and known[first] <= known[baseline]:
            found.append(
                f"Weak: outside the mask {first} does not beat {baseline} on held-out photos "
                f"({known[first]:.2f} against {known[baseline]:.2f} dB)."
            )
    crops = _collect_values(done, prior.PRIOR, "lpips_vgg")
    if prior.WIRED in crops and crops[prior.TUNED] >= crops[prior.WIRED]:
        found.append(
            f"Weak: fine-tuning the prior on this capture did not help it on held-out crops (LPIPS "
            f"{crops[prior.WIRED]:.3f} before, {crops[prior.TUNED]:.3f} after)."
        )
    opaque = _collect_values(done, names.STATISTICS, "opaque_share").get(first)
    if opaque is not None and opaque < 0.95:
        found.append(f"Weak: {1 - opaque:.0%} of the hole's pixels are less than 95 % opaque; fog or gaps remain.")
    ratio = _collect_values(done, names.STATISTICS, "gradient_ratio").get(first)
    if ratio is not None and not 0.4 <= ratio <= 2.5:
        look = "blurred" if ratio < 0.4 else "noisy"
        found.append(f"Weak: the filling looks {look} (gradient energy {ratio:.2f} of its surround's).")
    between = _collect_values(done, names.VARIETY, "lpips_between").get(names.EACH_PAIR)
    if between is not None and between < VISIBLY_APART:
        found.append(
            f"Weak: the seeds differ little (LPIPS {between:.3f} between two of them): most of the hole is known to "
            "other photos, or what surrounds it leaves one answer."
        )
    if masks.consistency is not None and masks.consistency < 0.7:
        found.append(f"Weak: masks of neighbouring views agree badly (mean IoU {masks.consistency:.2f}).")
    if not truth:
        found.append(
            "The capture has no views of the scene without the object: nothing here says whether the filling is true."
        )
    if not known:
        found.append("No held-out view could be scored: the field is untested outside the mask.")
    return found


def _collect_values(done: Sequence[Protocol], protocol: str, figure: str) -> dict[str, float]:
    metrics: list[Metric] = [m for p in done if p.name == protocol for m in p.metrics]
    return {m.method: m.value for m in metrics if m.name == figure}
