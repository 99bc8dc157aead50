"""What `fleet new` writes: files that run as they are. TheLaw and the_law are replaced by the names asked for."""
