"""A four-cell battery that drains slowly."""

from __future__ import annotations

_CAPACITY_MAH = 5000.0
_HOVER_A = 14.0
_IDLE_A = 0.8


class Battery:
    """A 5000 mAh pack; `fraction` in [0, 1] is its charge. Hovering empties it in 21 minutes."""

    def __init__(self, fraction: float = 1.0) -> None:
        self.fraction = fraction
        self.current_a = _IDLE_A

    @property
    def voltage(self) -> float:
        """Pack voltage, V: linear in the charge, minus a drop across 0.02 ohm under load."""
        return 4.0 * (3.5 + 0.65 * self.fraction) - 0.02 * self.current_a

    @property
    def used_mah(self) -> float:
        """Charge drawn since full, mAh."""
        return (1.0 - self.fraction) * _CAPACITY_MAH

    def step(self, dt_s: float, flying: bool) -> None:
        """Drain for dt_s seconds at the hover current, or at the idle current when not flying."""
        self.current_a = _HOVER_A if flying else _IDLE_A
        self.fraction = max(0.0, self.fraction - self.current_a * dt_s / (3.6 * _CAPACITY_MAH))
