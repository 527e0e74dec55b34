"""The files of a safety case, for several modules."""

from ...report.style import svg
from .argument import argument, to_yaml
from .case import SafetyCase
from .document import to_pdf
from .drawing import drawing, missing_letters

PDF, SVG, YAML = "safety-case.pdf", "safety-case.svg", "safety-case.yaml"


def case_files(case: SafetyCase) -> dict[str, bytes]:
    """Return the document, the drawing and the argument of a safety case, by the names of their files."""
    elements = argument(case)
    with missing_letters():
        picture = svg(drawing(elements, f"Safety case of the campaign {case.campaign}"))
    return {PDF: to_pdf(case), SVG: picture, YAML: to_yaml(elements).encode()}
