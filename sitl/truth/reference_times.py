"""What somebody who knows a scene would need, for the scenes where it was worked out: the yardstick of flight times.

Seconds of a tour that sees 95 % of the surface well: within 3 m and at an incidence under 70°. Worked out offline by ray
casting, for a vehicle whose centre keeps 0.35 m from everything and whose depth camera of 87 x 58° is tilted 15° down:
greedy views, then an open tour from the start at 1 m/s and 45°/s with 0.5 s per stop; no take-off.
"""

from __future__ import annotations

SEEN_WELL_S = {
    "narrow_room": 33.0,
    "meeting_room": 28.0,
    "kitchen_dining": 63.0,
    "office_pair": 64.0,
    "two_rooms": 104.0,
}
