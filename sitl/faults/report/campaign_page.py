"""The report faults.html: the results of a campaign on one self-contained page."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

from sitl.faults.report.scenario_result import Result

_NAMED = 5  # flights that missed a limit, at most

CSS = """
:root { --ink:#1f2933; --soft:#616e7c; --line:#e4e7eb; --ground:#f5f7fa; --good:#12805c; --bad:#b42318; }
* { box-sizing:border-box; margin:0; }
body { background:var(--ground); color:var(--ink); font:15px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif; }
main { max-width:1180px; margin:0 auto; padding:24px 16px 64px; display:grid; gap:18px; }
header { color:#fff; border-radius:18px; padding:24px 30px; background:linear-gradient(120deg,#0d6b4d,#1aa179); }
header.bad { background:linear-gradient(120deg,#8e1c13,#d3493d); }
section { background:#fff; border:1px solid var(--line); border-radius:14px; padding:16px 20px; overflow-x:auto; }
table { width:100%; border-collapse:collapse; }
td, th { text-align:left; vertical-align:top; padding:7px 14px 7px 0; }
tr + tr { border-top:1px solid var(--line); }
th, .soft { color:var(--soft); font-weight:400; }
b.pass { color:var(--good); } b.fail { color:var(--bad); }
td p { font-variant-numeric:tabular-nums; white-space:nowrap; }
p.long { white-space:normal; }
i { display:inline-block; width:54px; height:8px; margin-right:9px; border-radius:4px; background:var(--line); }
i { overflow:hidden; }
i u { display:block; height:100%; background:var(--good); } i.over u { background:var(--bad); }
"""
HOLDS = (
    "General limits of every flight: no contact (a touchdown on an obstacle below is none if the landing began without a"
    " pose); at most 0.30 m outside the fence; no NaN in MAVLink messages; no setpoint beyond the limits of speed,"
    " acceleration, yaw rate, step and inset fence; no mode or arm command after a pilot took over; no disarming in the air;"
    " never one minute of hovering unattended. Values come from the simulator's ground truth and from the captured MAVLink,"
    " decoded without the product's code. Each value is that of the scenario's worst flight; the bar beside it shows the used"
    " share of its limit."
)


def write_page(path: Path, results: Sequence[Result]) -> None:
    """Write the page. Raises OSError."""
    path.write_text(render(results), encoding="utf-8")


def render(results: Sequence[Result]) -> str:
    """Return the page as HTML."""
    flown = [r for r in results if r.passed is not None]
    failed = [f"{r.scenario.id} {r.autopilot}" for r in flown if not r.passed]
    title = f"{len(flown) - len(failed)} of {len(flown)} scenarios passed"
    missed = f"<p>failed: {html.escape(', '.join(failed))}</p>" if failed else ""
    groups = sorted({r.scenario.id[0] for r in results})
    tables = "".join(
        f"<section><table>{_head()}{''.join(_row(r) for r in results if r.scenario.id[0] == g)}</table></section>"
        for g in groups
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{title}</title><style>{CSS}</style><main>"
        f'<header class="{"bad" if failed else "good"}"><h1>{title}</h1>{missed}'
        f"<p>{len(results) - len(flown)} not flown</p>"
        f'</header>{tables}<section class="soft"><p>{HOLDS}</p></section></main></html>\n'
    )


def _head() -> str:
    return (
        "<tr><th>Scenario</th><th>Hazard</th><th>Injected fault</th><th>Autopilot</th><th>Flights</th>"
        "<th>Values and limits</th></tr>"
    )


def _row(result: Result) -> str:
    scenario, e = result.scenario, html.escape
    if result.passed is None:
        verdict, figures = '<span class="soft">not flown</span>', f'<p class="soft">{e(scenario.why)}</p>'
    else:
        word = "pass" if result.passed else "fail"
        verdict = f'<b class="{word}">{result.kept} of {result.seeds}</b>'
        figures = "".join(_gauge(share) + e(words) + "</p>" for words, share in result.used())
        figures += "".join(f'<p class="long">{e(words)}</p>' for words in (*result.remarks, *_again(result)))
    return (
        f'<tr><td>{e(scenario.id)}</td><td>{e(scenario.hazard)}</td><td class="soft">{e(scenario.injection)}</td>'
        f"<td>{e(f'{result.autopilot} {result.firmware}'.strip())}</td><td>{verdict}</td><td>{figures}</td></tr>"
    )


def _gauge(share: float) -> str:
    """Return the beginning of a paragraph, with a bar for the used share of a limit.

    The bar of a violated limit is full and red.
    """
    broken = ' class="over"' if share > 1.0 + 1e-9 else ""
    return f'<p><i{broken}><u style="width:{100 * min(share, 1.0):.0f}%"></u></i>'


def _again(result: Result) -> list[str]:
    """Return the commands that repeat the flights which missed a limit."""
    return [f"repeat: uav-recon faults {result.again(number)}" for number in result.missed[:_NAMED]]
