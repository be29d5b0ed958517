"""Joint covariance of the body's state and of the places of the keyframes.

A frame measures its place against keyframes, never against odom. So the errors of body and keyframes are correlated, and
only their joint covariance says what a frame tells of each: a keyframe that was just taken has the error of the body, and says
nothing of it; one from before, once it is in view again, corrects the body and all keyframes since.
Roumeliotis and Burdick 2002, Stochastic Cloning; Smith, Self and Cheeseman 1990, for the joint covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray

_LAGS = 2  # earlier places of the body, beside the keyframes
_FIRST_LAG_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class PlaceErrors:
    """Covariance of the body's state and of earlier places. Immutable.

    body (S, S): of the state, whose first three elements are the place. cross (S, 3 P): of it with the earlier places. places
    (3 P, 3 P): of these; m² along the axes of odom. The first of the P places are those of the body lately, the others those of
    the keyframes 0, 1, ... ``lag``: which of the first is the older one. ``before``: number of the keyframes that are older.
    """

    body: FloatArray
    cross: FloatArray
    places: FloatArray
    lag: int
    before: int

    @staticmethod
    def start(body: FloatArray) -> PlaceErrors:
        """Return those of a body without keyframes."""
        size = 3 * _LAGS
        return PlaceErrors(body, np.zeros((len(body), size)), _FIRST_LAG_M**2 * np.eye(size), 0, 0)

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return len(self.places) // 3 - _LAGS

    @property
    def variance(self) -> FloatArray:
        """Variance (N, 3) of the places of the keyframes."""
        return np.diagonal(self.places)[3 * _LAGS :].reshape(-1, 3)

    def at_rest(self, body: FloatArray) -> PlaceErrors:
        """Return those of a body that rests: its state (S, S) is known apart from the keyframes."""
        return replace(self, body=body, cross=np.zeros_like(self.cross))

    def predicted(self, body: FloatArray, transition: FloatArray) -> PlaceErrors:
        """Return those of a later state of this covariance (S, S). transition (S, S): of its errors."""
        return replace(self, body=body, cross=transition @ self.cross)

    def with_keyframe(self, placed_m: float) -> PlaceErrors:
        """Return those with one more keyframe, where the body is.

        placed_m: standard deviation of its surfaces against the body.
        """
        size, place = len(self.places), slice(0, 3)
        places = np.zeros((size + 3, size + 3))
        places[:size, :size] = self.places
        places[size:, :size], places[:size, size:] = self.cross[place], self.cross[place].T
        places[size:, size:] = self.body[place, place] + placed_m**2 * np.eye(3)
        return replace(self, cross=np.hstack((self.cross, self.body[:, place])), places=places)

    def with_lag(self) -> PlaceErrors:
        """Return those in which the place of the body now replaces the older one of those lately."""
        old, place = slice(3 * self.lag, 3 * self.lag + 3), slice(0, 3)
        cross, places = self.cross.copy(), self.places.copy()
        cross[:, old] = self.body[:, place]
        places[old, :], places[:, old] = cross[place], cross[place].T
        return replace(self, cross=cross, places=places, lag=(self.lag + 1) % _LAGS, before=self.count)

    def without_newest(self, count: int) -> PlaceErrors:
        """Return those of the first keyframes only."""
        size = 3 * (_LAGS + count)
        return replace(self, cross=self.cross[:, :size], places=self.places[:size, :size], before=min(self.before, count))

    def joint(self, numbers: IntArray) -> FloatArray:
        """Return the covariance (6 + 3 M, 6 + 3 M) of the body's place, of that one or two seconds ago, and of M keyframes."""
        at = self._elements(numbers)
        out = np.empty((3 + len(at), 3 + len(at)))
        out[:3, :3], out[:3, 3:] = self.body[:3, :3], self.cross[:3, at]
        out[3:, :3], out[3:, 3:] = self.cross[:3, at].T, self.places[np.ix_(at, at)]
        return out

    def apart(self) -> FloatArray:
        """Return the variance (N, 3) of the way from each keyframe to the body."""
        each = np.arange(self.count)[:, None] * 3 + np.arange(3)
        cross = self.cross[:, 3 * _LAGS :][np.arange(3), each]
        return np.asarray(np.diagonal(self.body)[:3] + self.variance - 2.0 * cross)

    def against_lag(self) -> FloatArray:
        """Return the covariance (S, S) of the state with the place against that one or two seconds ago."""
        lag, place = slice(3 * self.lag, 3 * self.lag + 3), slice(0, 3)
        body = self.body.copy()
        body[:, place] -= self.cross[:, lag]
        body[place, :] -= self.cross[:, lag].T
        body[place, place] += self.places[lag, lag]
        return body

    def updated(self, numbers: IntArray, moved_m: FloatArray, joint: FloatArray) -> tuple[PlaceErrors, FloatArray, FloatArray]:
        """Return those after a frame, by what the body's state (S,) is corrected, and the places (N, 3) of the keyframes.

        moved_m (6 + 3 M,): correction of joint()'s places. joint (6 + 3 M, 6 + 3 M): their covariance after it.
        """
        at = self._elements(numbers)
        before = self.joint(numbers)
        by_body = np.hstack((self.body[:, :3], self.cross[:, at]))
        by_places = np.hstack((self.cross[:3].T, self.places[:, at]))
        inverse = np.linalg.inv(before)
        body_gain, gain = by_body @ inverse, by_places @ inverse
        less = before - joint
        by_body, by_places = body_gain @ less, gain @ less
        body = self.body - by_body @ body_gain.T
        after = replace(
            self, body=0.5 * (body + body.T), cross=self.cross - by_body @ gain.T, places=self.places - by_places @ gain.T
        )
        return after, body_gain @ moved_m, (gain @ moved_m)[3 * _LAGS :].reshape(-1, 3)

    def _elements(self, numbers: IntArray) -> IntArray:
        """Return the elements (3 + 3 M,) of the lag and of keyframes among the places."""
        first = np.concatenate(([self.lag], _LAGS + numbers)).astype(np.int64)
        return np.asarray(3 * first[:, None] + np.arange(3)).ravel()
