"""`fleet reproduce`: the paper's simulation section once more, and a verdict on each of its claims."""
