"""Code of the user, such as laws, plants and checks: found, allowed, checked, and fenced in while it runs."""
