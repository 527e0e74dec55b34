"""What declared disturbances explain of the rollouts of a calibration, as the control of a campaign takes it out.

| symbol | name     | meaning                                                  | shape     | unit   |
|--------|----------|----------------------------------------------------------|-----------|--------|
| J      | `values` | values of k rollouts at each start                       | (n, k)    | unit J |
| t      | `scores` | scores of the disturbances of each                       | (n, k, w) | -      |
| u      | `shares` | starts, each parameter as a share of its range           | (n, p)    | -      |
| g      |          | what a control explains of a rollout; its mean is 0      | (n, k)    | unit J |

A control that was fitted on a rollout explains its noise as well, so that the noise that is left would look too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...mathematics.control.basis import Basis
from ...mathematics.control.sequence import Control, ControlSequence
from ...mathematics.gp.kernels import Floats


@dataclass(frozen=True, slots=True)
class PilotRollouts:
    """Rollouts, k at each of n starts."""

    shares: Floats
    scores: Floats
    values: Floats

    def half(self, first: int) -> "PilotRollouts":
        """Return those of every other start, from `first` on."""
        return PilotRollouts(self.shares[first::2], self.scores[first::2], self.values[first::2])


@dataclass(frozen=True, slots=True)
class PilotControl:
    """Two controls, each fitted on the rollouts of every other start; None explains nothing."""

    fitted: tuple[Control | None, Control | None]

    @classmethod
    def of(cls, bases: Sequence[Basis], ends: tuple[float, float], first: PilotRollouts) -> "PilotControl":
        """Fit the controls on the first rollouts, k >= 2; `ends` is the range of a value."""

        def fitted(half: PilotRollouts) -> Control | None:
            # One fit, on all of them.
            found = ControlSequence(bases, half.shares.shape[1], ends, half.values.size)
            places = _places(half.shares, half.values.shape[1]).reshape(*half.values.shape, -1)
            for start, (at, scores, x) in enumerate(zip(places, half.scores, half.values, strict=True)):
                found.add(start, at, scores, x)
            return found.control

        return cls((fitted(first.half(0)), fitted(first.half(1))))

    def of_first(self, first: PilotRollouts) -> Floats:
        """Return g (n, k) of the first rollouts: each by the control that was fitted on the other starts."""
        found = np.zeros(first.values.shape)
        for place, control in enumerate(reversed(self.fitted)):
            half = first.half(place)
            found[place::2] = _explained(control, half.shares, half.scores)
        return found

    def of_later(self, shares: Floats, scores: Floats) -> Floats:
        """Return g (n, k) of later rollouts: the mean of both controls'."""
        found: Floats = np.mean([_explained(control, shares, scores) for control in self.fitted], axis=0)
        return found


def _explained(control: Control | None, shares: Floats, scores: Floats) -> Floats:
    n, k, width = scores.shape
    if control is None:
        return np.zeros((n, k))
    return control.values(_places(shares, k), scores.reshape(n * k, width))[0].reshape(n, k)


def _places(shares: Floats, k: int) -> Floats:
    """Return starts from -1 to 1 for k rollouts at each, (n k, p)."""
    return np.repeat(2.0 * shares - 1.0, k, axis=0)
