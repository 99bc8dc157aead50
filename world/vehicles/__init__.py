"""The vehicles that ship with the package, as data with a unit and a source for each number."""
