"""The command line: options in, exit codes out; every verb imports its work when it is called."""
