"""What can be said about a run: before it, when it is judged, and about its clock."""
