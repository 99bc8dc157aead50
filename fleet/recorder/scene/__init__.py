"""The scene of a run at a time, as primitives that every renderer paints."""
