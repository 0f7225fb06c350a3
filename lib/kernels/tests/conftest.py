import pytest

from inpaint3d import kernels


@pytest.fixture(params=kernels.isas())
def isa(request):
    """Each path that this processor runs, forced."""
    before = kernels.isa()
    kernels.set_isa(request.param)
    yield request.param
    kernels.set_isa(before)
