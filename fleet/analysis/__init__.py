"""Analysis of a run: before it, when it is judged, and of its clock."""
