"""What `fleet new` writes: files that run as they are, in which TheLaw, the_law and the_scenario stand for names."""
