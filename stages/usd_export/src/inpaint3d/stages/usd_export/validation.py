"""USD's own validators over what was written."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from dataclasses import asdict, dataclass
from pathlib import Path

from pxr import Usd, UsdValidation


@dataclass(frozen=True)
class Finding:
    """One thing that a validator says."""

    file: str
    severity: str
    validator: str
    name: str
    message: str
    sites: list[str]


def validate(folder: Path, files: list[str]) -> list[Finding]:
    """Run every validator that USD ships over some files of a folder; paths in the messages are relative to it."""
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    findings: list[Finding] = []
    for name in files:
        stage = Usd.Stage.Open(str(folder / name))
        for error in context.Validate(stage):
            validator = error.GetValidator()
            findings.append(
                Finding(
                    file=name,
                    severity=error.GetType().name,
                    validator=validator.GetMetadata().name if validator else "",
                    name=str(error.GetName()),
                    message=error.GetMessage().replace(f"{folder}/", "").replace(str(folder), ""),
                    sites=sorted({_describe_site(site) for site in error.GetSites()}),
                )
            )
    return sorted(findings, key=lambda f: (f.file, f.severity, f.validator, f.name, f.message))


def as_document(findings: list[Finding]) -> dict[str, object]:
    """The content of validation.json."""
    return {
        "usd_version": ".".join(map(str, Usd.GetVersion())),
        "errors": sum(f.severity == "Error" for f in findings),
        "findings": [asdict(f) for f in findings],
    }


def _describe_site(site: UsdValidation.ValidationErrorSite) -> str:
    if site.IsPrim():
        return str(site.GetPrim().GetPath())
    if site.IsProperty():
        return str(site.GetProperty().GetPath())
    return "layer"
