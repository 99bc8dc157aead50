"""Laws of the user, behind the fence of plug-ins."""
