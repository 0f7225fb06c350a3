import numpy as np
import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.fields import RadianceField, Samples
from inpaint3d.radiance.sparse_point_metrics import measure_sparse_points
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.capture_io import SparsePoints

SPEC = FieldSpec(
    grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=2),
    proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    proposal_samples=(128, 128), samples=128, density_width=8, bottleneck=3, view_width=8, view_layers=1,
    near=0.05, far=100.0,
)  # fmt: skip
CAMERAS = [Camera(60, 60, 24, 18, 48, 36, look_at((0.9, y, 0.3), (0, 0, 0))) for y in (-0.2, 0.2)]


class Wall(RadianceField):
    """Opaque where x < 0; and fog that stops `fog` of the light where 0.5 < x < 0.6."""

    fog = 0.0

    def density(self, points: torch.Tensor) -> torch.Tensor:
        x = points[:, 0]
        return torch.where(x < 0, 1e4, torch.where((x > 0.5) & (x < 0.6), -np.log1p(-self.fog) / 0.1, 0.0))

    def proposal_density(self, points: torch.Tensor) -> torch.Tensor:
        return self.density(points) + 0.3

    def query(
        self,
        points: torch.Tensor,
        towards: torch.Tensor,
        appearance: torch.Tensor | None = None,
        specular_scale: float = 1.0,
    ) -> Samples:
        grey = torch.full((len(points), 3), 0.5)
        return Samples(self.density(points), grey, grey)


def on_the_wall(count: int, x: float = 0.0) -> SparsePoints:
    """Points with this x, each seen by both cameras."""
    rng = np.random.default_rng(0)
    xyz = np.column_stack([np.full(count, x), rng.uniform(-0.2, 0.2, (count, 2))]).astype(np.float32)
    return SparsePoints(
        xyz=xyz,
        rgb=np.zeros((count, 3), np.uint8),
        error=np.zeros(count, np.float32),
        track_offsets=np.arange(0, 2 * count + 1, 2),
        track_frame=np.tile(np.arange(2, dtype=np.int32), count),
        track_xy=np.zeros((2 * count, 2), np.float32),
    )


def test_points_on_the_surface_agree() -> None:
    found = measure_sparse_points(Wall(SPEC, 0), CAMERAS, on_the_wall(300), block=100)
    assert found is not None
    assert found.points == 600
    assert found.depth_error < 0.01
    assert found.floaters < 1e-3


def test_the_error_is_relative_to_the_points_distance() -> None:
    # The wall is met at nine tenths of the way to points that lie behind it: x goes from 0.9 to -0.1.
    found = measure_sparse_points(Wall(SPEC, 0), CAMERAS, on_the_wall(300, x=-0.1))
    assert found is not None
    assert found.depth_error == pytest.approx(0.1, abs=0.01)


def test_fog_in_front_of_the_points_is_counted_and_leaves_the_depth() -> None:
    field = Wall(SPEC, 0)
    field.fog = 0.2
    found = measure_sparse_points(field, CAMERAS, on_the_wall(300))
    assert found is not None
    # Rays slant: they stay in the fog for a little longer than its depth.
    assert found.floaters == pytest.approx(0.21, abs=0.03)
    assert found.depth_error < 0.01


def test_at_most_4096_sightings_are_looked_at_and_none_is_no_figure() -> None:
    many = measure_sparse_points(Wall(SPEC, 0), CAMERAS, on_the_wall(3000))
    assert many is not None
    assert many.points == 4096
    assert measure_sparse_points(Wall(SPEC, 0), CAMERAS, on_the_wall(0)) is None


def test_only_the_sightings_asked_for_are_looked_at() -> None:
    points = on_the_wall(300)
    points.xyz[::2, 0] = -0.1  # every other point lies behind the wall
    before = np.repeat(np.arange(300) % 2 == 1, 2)
    found = measure_sparse_points(Wall(SPEC, 0), CAMERAS, points, among=before)
    assert found is not None
    assert (found.points, found.depth_error < 0.01) == (300, True)
    assert measure_sparse_points(Wall(SPEC, 0), CAMERAS, points, among=np.zeros(600, bool)) is None
