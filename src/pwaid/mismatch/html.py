"""A self-contained HTML page of the report."""

from __future__ import annotations

import base64
from html import escape

__all__ = ["html_page"]


def html_page(report) -> str:
    """The whole page as text, pictures inlined."""
    from pwaid.mismatch.pictures import pictures

    c = report.content
    parts = [f"<h1>{escape(c['verdict'].replace('_', ' '))}</h1>", f"<pre>{escape(report.summary)}</pre>"]
    for title, png in pictures(report):
        data = base64.b64encode(png).decode("ascii")
        parts.append(f'<h2>{escape(title)}</h2><img alt="{escape(title)}" src="data:image/png;base64,{data}">')
    parts.append("<h2>Every candidate that was fitted</h2>" + _table(c))
    return ("<!doctype html><html lang='en'><head><meta charset='utf-8'><title>pwaid: explain the mismatch</title>"
            "<style>body{font:15px/1.45 sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}"
            "img{max-width:100%}pre{background:#f4f4f4;padding:1rem;white-space:pre-wrap}table{border-collapse:collapse}"
            "td,th{padding:.2rem .6rem;border-bottom:1px solid #ccc;text-align:left}</style></head><body>"
            + "\n".join(parts) + "</body></html>")


def _table(c) -> str:
    rows = ["<tr><th>candidate</th><th>family</th><th>share explained</th><th>held-out RMSE</th><th>passed</th></tr>"]
    for r in c["candidates"]:
        rmse = ", ".join(f"{k} {v:.4g}" for k, v in r["heldout_rmse"].items() if v is not None)
        share = "n/a" if r["share_explained"] is None else f"{100 * r['share_explained']:.1f} %"
        rows.append(f"<tr><td>{escape(r['where'])}</td><td>{escape(r['family'])}</td><td>{share}</td>"
                    f"<td>{escape(rmse)}</td><td>{'yes' if r['passed'] else 'no'}</td></tr>")
    return "<table>" + "".join(rows) + "</table>"
