"""What there is to see of a run at a time, as primitives that every renderer paints."""
