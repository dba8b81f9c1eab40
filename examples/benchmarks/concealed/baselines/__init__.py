"""Baselines on the same cases: scripts that take `CASE_DIR -o OUT` and write `report.json`, without pwaid."""
