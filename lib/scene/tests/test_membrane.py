"""A surface over a gap."""

import numpy as np

from inpaint3d.scene.membrane import span_membrane

Y, X = np.mgrid[:120, :160].astype(np.float64)
KNOWN = (X - 80) ** 2 + (Y - 60) ** 2 > 45**2


def test_a_plane_goes_on() -> None:
    """Whatever stood in the gap."""
    plane = 0.3 + 0.01 * X - 0.004 * Y
    made = span_membrane(np.where(KNOWN, plane, 99.0), KNOWN)
    np.testing.assert_array_equal(made[KNOWN], plane[KNOWN])
    np.testing.assert_allclose(made, plane, atol=1e-9)


def test_what_solves_laplaces_equation_is_found() -> None:
    solution = np.log(np.hypot(X + 20, Y + 30))
    made = span_membrane(np.where(KNOWN, solution, 99.0), KNOWN)
    assert np.abs(made - solution).max() < 0.01 * np.ptp(solution[~KNOWN])


def test_nothing_to_span() -> None:
    assert not span_membrane(X, np.zeros_like(KNOWN)).any()
    np.testing.assert_array_equal(span_membrane(X, np.ones_like(KNOWN)), X)
    one = np.zeros((5, 3), bool)
    one[4, 2] = True
    np.testing.assert_allclose(span_membrane(np.where(one, 7.0, 0.0), one), np.full((5, 3), 7.0))


def test_a_bent_surface_is_found_by_its_bend() -> None:
    """Poisson's equation: of a surface that is no plane, from its border and its Laplacian."""
    surface = 1e-3 * X**2 + np.sin(Y / 15) * np.cos(X / 11)
    padded = np.pad(surface, 1, mode="edge")
    bend = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:] - 4 * surface
    made = span_membrane(np.where(KNOWN, surface, 99.0), KNOWN, bend)
    np.testing.assert_allclose(made, surface, atol=1e-9)


def test_channels_are_spanned_as_each_alone() -> None:
    values, bend = np.random.default_rng(0).random((2, 9, 7, 3))
    known = np.random.default_rng(1).random((9, 7)) < 0.3
    for channel in range(3):
        alone = span_membrane(values[..., channel], known, bend[..., channel])
        np.testing.assert_allclose(span_membrane(values, known, bend)[..., channel], alone, rtol=1e-12)


def test_the_border_of_the_map_has_nothing_outside() -> None:
    """A gap that reaches it is as what is known beside it, not drawn towards 0."""
    known = X < 3
    np.testing.assert_allclose(span_membrane(np.where(known, 7.0, 99.0), known), np.full(X.shape, 7.0))


def test_what_is_imposed_falls_off_over_its_reach() -> None:
    known = X < 1
    made = span_membrane(np.where(known, 1.0, 0.0), known, reach=8.0)
    np.testing.assert_allclose(made[60, 1:80:8], np.exp(-X[60, 1:80:8] / 8), rtol=0.02)
