"""What `fleet new` writes: files that run as they are, in which TheLaw and the_law stand for the names asked for."""
