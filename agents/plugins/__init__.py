"""Laws of the user: found, allowed, checked, and fenced in while they run."""
