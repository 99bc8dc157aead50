"""Plants, which are vehicles with equations of their own: those that ship, and the user's behind the fence."""
