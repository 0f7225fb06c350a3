"""Exposure and white balance that differ between views: gains per view and channel."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Interval
from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.gains import fit_folds
from inpaint3d.scene.effects.intervals import from_parts

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

EFFECT = Description(
    name="exposure",
    what="exposure and white balance that differ between views",
    evidence="each view's gain per channel, from the colours of tracks; what it explains of held-out points' colours",
    off_means="no codes: every view shows the field's own colours",
    simulated_by="inpaint3d.radiance.fields.RadianceField.appearance",
    material=0.1,
    least_gain=0.03,
    unit="EV, 10 to 90 % of the views",
    criterion="held-out points",
)
FEWEST_POINTS = 50


def measure(evidence: "Evidence") -> Finding:
    """Spread of the views' gains, the largest of the channels.

    The camera's own word (EXIF) decides only where too few points have usable colours: automatic exposure may follow a
    change of light, so that settings differ while the pictures don't.
    """
    said = [v.relative_exposure for v in evidence.views if v.relative_exposure is not None]
    by_exif = _measure_spread(np.log2(said)) if said else 0.0
    figures = {"points": float(len(evidence.lit))} | ({"exif_spread_ev": by_exif} if said else {})
    if len(evidence.lit) < FEWEST_POINTS:
        words = f"only {len(evidence.lit)} points have usable colours; exposures by EXIF differ by {by_exif:.2f} EV"
        return Finding(words, figures=figures, unknown=by_exif > EFFECT.material)
    size, gain, gains = measure_channels(evidence)
    figures |= {"gain_spread_ev": size.value, "cast_spread_ev": _measure_spread(gains[:, 0] - gains[:, 2])}
    words = (
        f"the points' brightness differs between views by {size.value:.2f} EV (at least {size.low:.2f}; 10 to 90 % of "
        f"the views); gains explain {max(gain.value, 0):.0%} of the spread of points that were held out"
    )
    return Finding(words, size, gain, figures, {"gain_ev": tuple(gains.mean(-1).round(4).tolist())})


def measure_channels(evidence: "Evidence") -> tuple[Interval, Interval, NDArray[np.float64]]:
    """Spread and held-out gain of the channel whose views differ most, and every channel's gains [v, 3]."""
    values = evidence.light[evidence.lit]
    folds = [fit_folds(values[..., c]) for c in range(3)]
    spreads = [_measure_spread(every) for every, _, _ in folds]
    most = int(np.argmax(spreads))
    without = np.array([_measure_spread(gains) for gains in folds[most][1]])
    size = from_parts(spreads[most], without, EFFECT.unit)
    return size, folds[most][2], np.stack([every for every, _, _ in folds], -1)


def _measure_spread(values: NDArray[np.float64]) -> float:
    """10 to 90 % of the values; 0 for none."""
    return float(np.diff(np.quantile(values, (0.1, 0.9)))[0]) if len(values) else 0.0
