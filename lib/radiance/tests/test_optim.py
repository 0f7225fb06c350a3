import subprocess
import sys

import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.backends import Name
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.losses import hash_decay
from inpaint3d.radiance.optim import Adam

SPEC = FieldSpec(
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
)


@pytest.mark.parametrize("backend", ["reference", "native"])
def test_tables_decay_as_the_term_of_the_loss_would_have_them(backend: Name) -> None:
    """N9: Adam's own decay moves every entry as the gradient of 0.1 hash_decay, added to the loss's, would."""
    fields = [RadianceField(SPEC, 0, backend) for _ in range(2)]
    optimizers = [Adam(fields[0], hash_decay=0.1), Adam(fields[1])]
    for step in range(5):
        for field, optimizer, term in zip(fields, optimizers, (0.0, 0.1), strict=True):
            noise = torch.Generator().manual_seed(step)
            loss = term * hash_decay(field)
            for parameter in field.parameters():
                loss = loss + 1e-6 * (parameter * torch.randn(parameter.shape, generator=noise)).sum()
            field.zero_grad()
            loss.backward()
            optimizer.step(1e-2)
    start = RadianceField(SPEC, 0, backend)
    for (name, ours), theirs, before in zip(
        fields[0].named_parameters(), fields[1].parameters(), start.parameters(), strict=True
    ):
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0, msg=name)
        assert not torch.equal(ours, before)


def test_a_step_imports_no_compiler() -> None:
    """What torch imports for its own optimisers takes a stage seconds."""
    code = """
import sys, torch
from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.optim import Adam
field = RadianceField(FieldSpec(), 0)
optimizer = Adam(field)
field.density(torch.rand(8, 3)).sum().backward()
optimizer.step(1e-2)
assert optimizer.steps == 1
sys.exit('torch._dynamo' in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
