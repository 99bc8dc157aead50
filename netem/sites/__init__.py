"""The sites that ship with the package: water as it was at a sea trial, as data."""
