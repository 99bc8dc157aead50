"""Parts that the core does not need, each of which registers what it offers."""
