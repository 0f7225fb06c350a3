import numpy as np

from inpaint3d.stages.joint_optimization.centre_views import choose_centre_views


def test_centre_views_are_a_small_baseline_around_the_medoid() -> None:
    centres = np.array([[x, 0.0, 0.0] for x in (0.0, 1.0, 2.0, 3.0, 4.0, 50.0)])
    share = np.array([0.1, 0.1, 0.0, 0.1, 0.1, 0.1])
    # View 2 does not see the hole; 50 pulls a mean but not a medoid.
    assert choose_centre_views(centres, share, 2) == [3, 4]
    assert choose_centre_views(centres, share, 1) == [3]
