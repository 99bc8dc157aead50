"""Documents that `--json` prints: one struct per command, and the page that describes them."""
