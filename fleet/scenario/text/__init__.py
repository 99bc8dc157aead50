"""A scenario as text: YAML in with places, YAML out, and what options change."""
