import subprocess
import sys

from tests.conftest import REPOSITORY


def test_the_orchestrator_imports_no_tensor_library():
    """Nor what only a page needs: most commands make none."""
    heavy = ("numpy", "torch", "cv2", "OpenImageIO", "pycolmap", "pxr", "onnxruntime", "jinja2")
    code = f"import sys, inpaint3d.orchestrator.cli; sys.exit(','.join(m for m in {heavy} if m in sys.modules) or 0)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_a_plan_imports_no_tensor_library():
    """It holds parameters against the stages' own rules, and none of these may need what the stages compute with."""
    heavy = ("torch", "cv2", "OpenImageIO", "pycolmap", "pxr", "onnxruntime")
    code = (
        "import sys\nfrom pathlib import Path\nfrom inpaint3d.contracts.models.pipeline import Pipeline\n"
        "from inpaint3d.orchestrator.configure import Settings, configure\n"
        "configure(Pipeline(Path('pipeline.yaml')), Settings('standard'), {'capture'})\n"
        "assert 'inpaint3d.stages.joint_optimization.config' in sys.modules\n"
        f"sys.exit(','.join(m for m in {heavy} if m in sys.modules) or 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
