"""What `--json` prints where it joins several structs, and the page of all documents."""
