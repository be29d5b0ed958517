"""Memory and descriptors of a process over hours: growth rates and a chart."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

SETTLING = 0.2  # share of the time in which a process may still allocate its working memory
_HOUR_S = 3600.0
_WIDTH = 760.0
_HEIGHT = 260.0
_MARGIN = 40.0
_LINE = 18.0
_COLOURS = ("#12805c", "#1f6feb", "#b42318", "#9a6700", "#8250df")


@dataclass
class Track:
    """Samples of one process.

    since_s: seconds since the fault began. memory_mb: memory (MB). descriptors: number of open descriptors.
    """

    pid: int
    since_s: list[float] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)

    def mb_per_h(self) -> float:
        """Return the slope (MB/h) of the least-squares line through the memory after SETTLING.

        It returns NaN for fewer than three samples.
        """
        after = int(np.searchsorted(self.since_s, SETTLING * self.since_s[-1]))
        hours, memory_mb = np.array(self.since_s[after:]) / _HOUR_S, np.array(self.memory_mb[after:])
        if len(hours) < 3:
            return float("nan")
        away = hours - hours.mean()
        return float(away @ memory_mb / (away @ away))

    def more_descriptors(self) -> float:
        """Return the growth of the number of descriptors.

        It is the minimum in the last tenth of the time minus that in the first, so a descriptor that is opened and closed
        does not count.
        """
        tenth = max(len(self.descriptors) // 10, 1)
        return float(min(self.descriptors[-tenth:]) - min(self.descriptors[:tenth]))


def draw(tracks: Mapping[str, Track]) -> str:
    """Return a chart as SVG: memory growth (MB) of each process over time (h).

    Slope and number of descriptors are given as text.
    """
    hours = [np.array(track.since_s) / _HOUR_S for track in tracks.values()]
    more_mb = [np.array(track.memory_mb) - track.memory_mb[0] for track in tracks.values()]
    longest_h = max((float(h[-1]) for h in hours), default=1.0) or 1.0
    low_mb, high_mb = min((float(m.min()) for m in more_mb), default=0.0), max((float(m.max()) for m in more_mb), default=0.0)
    high_mb = max(high_mb, low_mb + 1.0)  # a range of at least 1 MB, so that constant memory is drawn flat
    lines = [_words(_MARGIN, 16.0, f"megabytes more than at first: {low_mb:.1f} to {high_mb:.1f}, over {longest_h:.2f} hours")]
    for k, ((name, track), h, m) in enumerate(zip(tracks.items(), hours, more_mb, strict=True)):
        x = _MARGIN + h / longest_h * (_WIDTH - 2 * _MARGIN)
        y = _HEIGHT - (m - low_mb) / (high_mb - low_mb) * (_HEIGHT - _MARGIN)
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in zip(x.tolist(), y.tolist(), strict=True))
        colour = _COLOURS[k % len(_COLOURS)]
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
        said = f"{name}: {track.memory_mb[-1]:.1f} MB, {track.mb_per_h():+.2f} MB/h, {track.descriptors[-1]} descriptors"
        lines.append(_words(_MARGIN, _HEIGHT + _LINE * (k + 1), f"{said}, {track.more_descriptors():+.0f}", colour))
    height = _HEIGHT + _LINE * (len(tracks) + 1)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH:g} {height:g}" font-family="sans-serif" font-size="13">'
        f'<rect width="100%" height="100%" fill="#fff"/>{"".join(lines)}</svg>\n'
    )


def _words(x: float, y: float, said: str, colour: str = "#1f2933") -> str:
    return f'<text x="{x:g}" y="{y:g}" fill="{colour}">{said}</text>'
