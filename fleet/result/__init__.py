"""The result of a run, declared once for Python, `--json`, `result.json`, reports and studies."""
