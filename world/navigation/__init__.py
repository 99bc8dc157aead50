"""Where a vehicle believes it is: instruments, fixes and the filter, and the grades of navigation that ship, as data."""
