"""Documents for Kubernetes: their types checked by hera's models, and YAML that it reads as it was meant."""

from typing import Any, cast

import yaml

from inpaint3d.contracts.errors import ConfigurationError

Document = dict[str, Any]


def check_types(document: Document) -> Document:
    """The document as hera's model of its kind has it. ConfigurationError where a field is not Argo's."""
    from hera.workflows import models
    from pydantic import ValidationError

    kinds: dict[str, Any] = {"WorkflowTemplate": models.WorkflowTemplate, "Workflow": models.Workflow}
    kind = document.get("kind")
    if kind not in kinds:
        raise ConfigurationError(f"kind {kind!r} is none of {', '.join(kinds)}")
    try:
        model = kinds[kind].model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigurationError(f"{kind}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    kept = cast(Document, model.model_dump(mode="json", by_alias=True, exclude_none=True))
    # The models ignore what they do not know: a typo is what did not come back.
    if lost := _find_lost(document, kept):
        raise ConfigurationError(f"{kind}: Argo has no field {lost}")
    return kept


def _find_lost(given: Any, kept: Any, at: str = "") -> str | None:
    if isinstance(given, dict) and isinstance(kept, dict):
        for name, value in cast(Document, given).items():
            if name not in kept:
                return f"{at}.{name}".removeprefix(".")
            if found := _find_lost(value, kept[name], f"{at}.{name}"):
                return found
    if isinstance(given, list) and isinstance(kept, list):
        pairs = zip(cast(list[Any], given), cast(list[Any], kept), strict=True)
        return next((found for i, (g, k) in enumerate(pairs) if (found := _find_lost(g, k, f"{at}.{i}"))), None)
    return None


def dump(documents: list[Document]) -> str:
    """YAML that Kubernetes reads as it was meant."""
    return yaml.dump_all(documents, Dumper=_Dumper, sort_keys=False, width=120)


class _Dumper(yaml.SafeDumper):
    def represent_text(self, text: str) -> yaml.Node:
        # YAML 1.1, which Kubernetes reads, has `n` and `y` for booleans; PyYAML would leave them bare.
        quoted = text.lower() in ("y", "n")
        return cast(Any, self).represent_scalar("tag:yaml.org,2002:str", text, style='"' if quoted else None)


_Dumper.add_representer(str, _Dumper.represent_text)
