"""Plants: vehicles with equations of their own, both shipped ones and those of users."""
