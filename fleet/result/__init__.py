"""What a run came to, declared once: for Python, `--json`, `result.json`, reports and studies."""
