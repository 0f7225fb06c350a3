import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec, RadianceFieldArtifact
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.radiance.fields import RadianceField, Samples
from inpaint3d.radiance.io import save_field
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.stages.evaluation.bench import Bench
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.hole_protocols import score_neighbouring_views
from inpaint3d.stages.evaluation.methods import Method
from inpaint3d.stages.evaluation.photos import Photo

SPEC = FieldSpec(
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    proposal_samples=(64, 64), samples=32, density_width=8, bottleneck=0, view_layers=0, near=0.05, far=100.0,
)  # fmt: skip


class Room(RadianceField):
    """A field whose weights are not asked: the inside of a painted ball of radius 1, or fog of one density."""

    fog: float | None = None

    def density(self, points: torch.Tensor) -> torch.Tensor:
        if self.fog is not None:
            return torch.full((len(points),), self.fog)
        return torch.where(torch.linalg.vector_norm(points, dim=-1) > 1, 1e6, 0.0)

    def proposal_density(self, points: torch.Tensor) -> torch.Tensor:
        return self.density(points)

    def query(
        self,
        points: torch.Tensor,
        towards: torch.Tensor,
        appearance: torch.Tensor | None = None,
        specular_scale: float = 1.0,
    ) -> Samples:
        paint = 0.5 + 0.5 * torch.sin(3 * torch.nn.functional.normalize(points, dim=1))
        return Samples(self.density(points), paint, paint)


@pytest.fixture
def store(tmp_path) -> Store:
    return FolderStore(tmp_path / "store")


def method(store: Store, label: str, fog: float | None = None) -> Method:
    model = Room(SPEC, seed=0)
    model.fog = fog
    folder = store.private_folder()
    save_field(folder / "weights.safetensors", model)
    (folder / "learning_curve.csv").write_text("step,rays,loss,psnr\n")
    metadata = RadianceFieldArtifact(label=label, spec=SPEC, views=(), steps=0, seed=0, backend="reference")
    digest = store.put(folder, "radiance-field", metadata)
    return Method(label, model, store.open(digest, RadianceFieldArtifact))


def photo(name: str, x: float) -> Photo:
    camera = Camera(40, 40, 16, 12, 32, 24, look_at((x, 0.0, 0.0), (x, 1.0, 0.0)))
    hole = np.zeros((24, 32), bool)
    hole[8:16, 10:20] = True
    return Photo(name, "train", camera, np.zeros((24, 32, 3), np.float32), hole, ~hole)


def test_a_wall_has_no_spread_of_depth_and_fog_that_of_an_exponential(store):
    """Light that stops at rate 2 from 0.05 on: mean 0.55, standard deviation 0.5."""
    view = photo("a", 0.0)
    assert method(store, "wall").depth_spread(view, view.hole, 64) < 0.05
    # 32 samples of a long tail: a tenth is what they miss.
    assert method(store, "fog", 2.0).depth_spread(view, view.hole, 64) == pytest.approx(0.5 / 0.55, rel=0.1)


def test_where_no_light_stops_depth_has_no_spread(store):
    view = photo("a", 0.0)
    assert method(store, "nothing", 0.0).depth_spread(view, view.hole, 64) == 0


def test_a_painted_wall_looks_the_same_from_the_next_view(store):
    """Its colours differ by what bilinear sampling loses; a second paint in the hole of one view would show."""
    bench = Bench([method(store, "wall")], Config(), tick=lambda message: None)
    views = [photo("a", 0.0), photo("b", 0.15), photo("c", -0.6)]
    (protocol,) = score_neighbouring_views(bench, views[:1], views)
    figures = {m.name: m.value for m in protocol.metrics}
    assert figures.keys() == {"reprojection_hole", "reprojection_known"}
    assert max(figures.values()) < 0.02
    bench.renders["wall", "b"]["rgb"][8:16] = 0.0
    bench.scores.rows.clear()
    (protocol,) = score_neighbouring_views(bench, views[:1], views)
    painted = {m.name: m.value for m in protocol.metrics}
    assert painted["reprojection_hole"] > 0.2
    bench.scores.rows.clear()
    assert score_neighbouring_views(bench, views[:1], views[:1]) == []
