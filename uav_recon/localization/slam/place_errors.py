"""Joint covariance of the body's state and of the places of the keyframes.

A frame measures its place against keyframes, never against odom. So the errors of body and keyframes are correlated, and
only their joint covariance says what a frame tells of each: a keyframe that was just taken has the error of the body, and says
nothing of it; one from before, once it is in view again, corrects the body and all keyframes since.
Roumeliotis and Burdick 2002, Stochastic Cloning; Smith, Self and Cheeseman 1990, for the joint covariance; Schmidt 1966, for
places that an update leaves where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.small_matrices import symmetric_eigen
from uav_recon.types.frames import AnyArray, FloatArray, IntArray

PLACE = slice(0, 3)  # of the body's state
_FIRST_LAG_M = 1e-3
_FIRST_CAPACITY = 64  # keyframes
_LEAST_GAIN = 0.01  # a keyframe that an update would move by less than this share of the corrections stays where it is
_MOST_MOVED = 100  # keyframes that an update moves, those by most: its time grows with their number


@dataclass(frozen=True, slots=True, eq=False)
class Update:
    """Change of the places of keyframes by an update.

    Their elements (A,), and the factors (A, K), (3 N, K) of the difference.
    """

    elements: IntArray
    by_active: FloatArray
    gain: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PlaceErrors:
    """Covariance of the body's state, two of its earlier places, and the places of N keyframes.

    body (S + 6, S + 6): of the state, whose first three elements are the place, and of the earlier places. cross (S + 6, 3 N):
    of these with the keyframes; m² along the axes of odom. ``lag``: which of the earlier places is the older one, 0 or 1.
    ``before``: number of the keyframes that are older than it.

    All but the covariance of the keyframes among each other is immutable; this is shared by those that follow each other, and
    an update must be undone before an earlier one is used again.
    """

    body: FloatArray
    cross: FloatArray
    shared: FloatArray
    lag: int
    before: int

    @staticmethod
    def start(state: FloatArray) -> PlaceErrors:
        """Return those of a body without keyframes. state (S, S): covariance of its state."""
        size = len(state)
        body = _FIRST_LAG_M**2 * np.eye(size + 6)
        body[:size, :size] = state
        return PlaceErrors(body, np.zeros((size + 6, 0)), np.zeros((3 * _FIRST_CAPACITY, 3 * _FIRST_CAPACITY)), 0, 0)

    @property
    def count(self) -> int:
        """Number of keyframes."""
        return int(self.cross.shape[1] // 3)

    @property
    def state(self) -> FloatArray:
        """Covariance (S, S) of the body's state."""
        return self.body[:-6, :-6]

    @property
    def places(self) -> FloatArray:
        """Covariance (3 N, 3 N) of the keyframes."""
        size = self.cross.shape[1]
        return self.shared[:size, :size]

    @property
    def variance(self) -> FloatArray:
        """Variance (N, 3) of the places of the keyframes."""
        return np.diagonal(self.places).reshape(-1, 3)

    def at_rest(self, state: FloatArray) -> PlaceErrors:
        """Return those of a body that rests: its state (S, S) is known apart from the keyframes."""
        return replace(self, body=PlaceErrors.start(state).body, cross=np.zeros_like(self.cross))

    def predicted(self, state: FloatArray, transition: FloatArray) -> PlaceErrors:
        """Return those of a later state of this covariance (S, S). transition (S, S): of its errors."""
        size, body, cross = len(state), self.body.copy(), self.cross.copy()
        body[:size, :size] = state
        body[:size, size:] = transition @ self.body[:size, size:]
        body[size:, :size] = body[:size, size:].T
        cross[:size] = transition @ self.cross[:size]
        return replace(self, body=body, cross=cross)

    def with_keyframe(self, placed_m: float) -> PlaceErrors:
        """Return those with one more keyframe, where the body is.

        placed_m: standard deviation of its surfaces against the body.
        """
        size, shared = self.cross.shape[1], self.shared
        if size == len(shared):
            shared = np.zeros((2 * size, 2 * size))
            shared[:size, :size] = self.shared
        shared[size : size + 3, :size], shared[:size, size : size + 3] = self.cross[PLACE], self.cross[PLACE].T
        shared[size : size + 3, size : size + 3] = self.body[PLACE, PLACE] + placed_m**2 * np.eye(3)
        return replace(self, cross=np.hstack((self.cross, self.body[:, PLACE])), shared=shared)

    def with_lag(self) -> PlaceErrors:
        """Return those in which the place of the body now replaces the older one of those lately."""
        taken = np.eye(len(self.body))
        taken[self._lag] = taken[PLACE]
        return replace(self, body=taken @ self.body @ taken.T, cross=taken @ self.cross, lag=1 - self.lag, before=self.count)

    def joint(self, numbers: IntArray) -> FloatArray:
        """Return the covariance (6 + 3 M, 6 + 3 M) of places.

        Those of the body now, one or two seconds ago, and of M keyframes.
        """
        own, at = self._own, _elements(numbers)
        out = np.empty((6 + len(at), 6 + len(at)))
        out[:6, :6], out[6:, 6:] = self.body[own[:, None], own], self.shared[at[:, None], at]
        out[:6, 6:] = self.cross[own[:, None], at]
        out[6:, :6] = out[:6, 6:].T
        return out

    def against_lag(self) -> FloatArray:
        """Return the covariance (S, S) of the state with the place against that lately.

        That is the place one or two seconds ago.
        """
        against = np.eye(len(self.body))
        against[PLACE, self._lag] = -np.eye(3)
        return np.asarray(against @ self.body @ against.T)[:-6, :-6]

    def updated(
        self, numbers: IntArray, moved_m: FloatArray, joint: FloatArray
    ) -> tuple[PlaceErrors, FloatArray, FloatArray, Update]:
        """Return those after a frame.

        Also returns by what the body's state (S,) is corrected, and the places (N, 3) of the keyframes, and what undo() needs.
        moved_m (6 + 3 M,): correction of joint()'s places. joint (6 + 3 M, 6 + 3 M): their covariance after it.
        """
        own, at, before = self._own, _elements(numbers), self.joint(numbers)
        inverse = np.linalg.inv(before)
        body_gain = np.hstack((self.body[:, own], self.cross[:, at])) @ inverse
        gain = np.hstack((self.cross[own].T, self.shared[: self.cross.shape[1], at])) @ inverse
        less = _positive(before - joint)
        by_body = body_gain @ less
        moves = np.abs(gain.reshape(-1, 3, gain.shape[1])).max(axis=(1, 2))
        most = np.argsort(-moves, kind="stable")[:_MOST_MOVED]
        active = _elements(np.sort(most[moves[most] > _LEAST_GAIN]))
        update = Update(active, gain[active] @ less, gain)
        self._add(update, -1.0)
        body = self.body - by_body @ body_gain.T
        corrected_m = np.zeros(len(gain))
        corrected_m[active] = gain[active] @ moved_m
        after = replace(self, body=0.5 * (body + body.T), cross=self.cross - by_body @ gain.T)
        return after, (body_gain @ moved_m)[:-6], corrected_m.reshape(-1, 3), update

    def undo(self, update: Update) -> None:
        """Take back what an update has changed among the keyframes."""
        self._add(update, 1.0)

    def redo(self, update: Update) -> None:
        """Change again what was taken back."""
        self._add(update, -1.0)

    def _add(self, update: Update, sign: float) -> None:
        size, active = len(update.gain), update.elements
        changed = self.shared[active, :size] + sign * update.by_active @ update.gain.T
        self.shared[active, :size] = changed
        self.shared[:size, active] = changed.T

    @property
    def _lag(self) -> slice:
        first = len(self.body) - 6 + 3 * self.lag
        return slice(first, first + 3)

    @property
    def _own(self) -> IntArray:
        """Elements (6,) of the place and the older one of those lately."""
        return np.concatenate((np.arange(3), np.arange(self._lag.start, self._lag.stop)))


@kernel
def worst_variances(joint: AnyArray) -> AnyArray:
    """Return the variances (1 + M,) of the ways from the place to others.

    Each in its worst direction, m². To the one lately, and to those of M keyframes.
    joint (6 + 3 M, 6 + 3 M): of PlaceErrors.joint().
    """
    out = np.empty(joint.shape[0] // 3 - 1)
    for m in range(out.shape[0]):
        first, last = 3 + 3 * m, 6 + 3 * m
        way = joint[:3, :3] - joint[:3, first:last] - joint[first:last, :3] + joint[first:last, first:last]
        out[m] = symmetric_eigen(way)[0][2]
    return out


def _positive(matrix: FloatArray) -> FloatArray:
    """Return the nearest symmetric matrix without negative eigenvalues, which are from rounding."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _elements(numbers: IntArray) -> IntArray:
    """Return the elements (3 M,) of keyframes."""
    return np.asarray(3 * numbers.astype(np.int64)[:, None] + np.arange(3)).ravel()
