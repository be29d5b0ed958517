"""Style sheet of report.html."""

from __future__ import annotations

CSS = """
:root { --ink:#1f2933; --soft:#616e7c; --line:#e4e7eb; --ground:#f5f7fa; --good:#12805c; --fair:#b4690e; --bad:#b42318; }
* { box-sizing:border-box; margin:0; }
body { background:var(--ground); color:var(--ink);
  font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif; }
main { max-width:1180px; margin:0 auto; padding:24px 16px 64px; display:grid; gap:20px; }
header { color:#fff; border-radius:18px; padding:28px 32px; }
header.good { background:linear-gradient(120deg,#0d6b4d,#1aa179); }
header.fair { background:linear-gradient(120deg,#8f5209,#d08a2a); }
header.bad { background:linear-gradient(120deg,#8e1c13,#d3493d); }
h1 { font-size:clamp(24px,4.5vw,38px); line-height:1.15; letter-spacing:-.02em; text-wrap:balance; }
.stop { margin-top:8px; font-size:17px; opacity:.95; }
.chips { margin-top:16px; display:flex; flex-wrap:wrap; gap:8px; }
.chips span { background:rgba(255,255,255,.18); border-radius:99px; padding:3px 12px; font-size:14px; }
.tiles { display:grid; grid-template-columns:repeat(auto-fit,minmax(150px,1fr)); gap:12px; }
@media (min-width:900px) { .tiles { grid-template-columns:repeat(4,1fr); } }
.tiles div, .hero figure, .pictures figure, .tables section, .notes {
  background:#fff; border:1px solid var(--line); border-radius:14px; }
.tiles div { padding:14px 18px; }
.tiles h3 { font-size:13px; font-weight:600; color:var(--soft); }
.tiles b { font-size:28px; letter-spacing:-.02em; font-variant-numeric:tabular-nums; white-space:nowrap; }
.tiles p { font-size:13px; color:var(--soft); line-height:1.3; }
.pictures { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr)); gap:16px; align-items:start; }
@media (min-width:1000px) { .pictures figure:last-child:nth-child(odd) { grid-column:1 / -1; } }
figure { overflow:hidden; }
figure img { display:block; width:100%; height:auto; }
figcaption { padding:10px 18px 14px; font-size:14px; color:var(--soft); border-top:1px solid var(--line); }
.tables { display:grid; grid-template-columns:repeat(auto-fit,minmax(min(100%,440px),1fr)); gap:16px; align-items:start; }
.tables section, .notes { padding:18px 22px; }
h2 { font-size:17px; margin-bottom:8px; }
table { width:100%; border-collapse:collapse; }
tr + tr { border-top:1px solid var(--line); }
th { text-align:left; font-weight:400; color:var(--soft); padding:6px 12px 6px 0; font-size:15px; }
td { text-align:right; font-variant-numeric:tabular-nums; white-space:nowrap; font-size:15px; }
.files { margin-top:12px; display:flex; flex-wrap:wrap; gap:4px 14px; font-size:14px; }
a { color:#1d4ed8; text-decoration:none; }
a:hover { text-decoration:underline; }
.notes p { font-size:14px; color:var(--soft); max-width:90ch; }
.notes p + p { margin-top:8px; }
@media print { body { background:#fff; } header { -webkit-print-color-adjust:exact; print-color-adjust:exact; } }
"""
