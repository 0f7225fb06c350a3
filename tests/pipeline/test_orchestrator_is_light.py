import subprocess
import sys


def test_the_orchestrator_imports_no_tensor_library():
    heavy = ("numpy", "torch", "cv2", "OpenImageIO", "pycolmap", "pxr", "onnxruntime")
    code = f"import sys, inpaint3d.orchestrator.cli; sys.exit(','.join(m for m in {heavy} if m in sys.modules) or 0)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
