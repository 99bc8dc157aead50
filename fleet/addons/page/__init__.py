"""A run or a log on a screen: found by its name, shown live or played, and disturbed from there."""
