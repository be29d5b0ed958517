"""Reference flight times (s) of a planner that knows the scene, by scene name.

The tour sees 95 % of the surface within 3 m and at an incidence below 70°. It was computed offline by ray casting for a
vehicle whose centre keeps 0.35 m from every surface and whose 87 x 58° depth camera is tilted 15° down: greedy selection
of views, then an open tour from the start at 1 m/s and 45°/s with 0.5 s per stop, without take-off.
"""

from __future__ import annotations

REFERENCE_TIMES_S = {
    "narrow_room": 33.0,
    "meeting_room": 28.0,
    "kitchen_dining": 63.0,
    "office_pair": 64.0,
    "two_rooms": 104.0,
}
