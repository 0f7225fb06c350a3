"""Pages and parts of pages, from templates that lie beside the code that fills them."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jinja2 import Environment


def render(package: str, template: str, **values: object) -> str:
    """Fill a template that lies in a package's folder; other templates take the result as it is.

    Values are escaped. A template may extend `page.html.j2`, the frame of a page with its style, and import
    `parts.html.j2`. Raises jinja2.UndefinedError where the template names what it was not given.
    """
    from markupsafe import Markup

    return Markup(_make_environment(package).get_template(template).render(**values))  # noqa: S704 - its values are escaped


@cache
def _make_environment(package: str) -> "Environment":
    # Imported where a page is made: a command line that makes none starts without it.
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    from inpaint3d.report.bytecode import TemplateBytecode

    loaders = [PackageLoader(name, ".") for name in (package, "inpaint3d.report")]
    return Environment(
        loader=ChoiceLoader(loaders),
        autoescape=True,
        undefined=StrictUndefined,
        bytecode_cache=TemplateBytecode(Path(__file__).parent / "__pycache__"),
        trim_blocks=True,
        lstrip_blocks=True,
    )
