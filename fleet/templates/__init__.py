"""Templates of `fleet new`: files that run at once, in which TheLaw, the_law and the_scenario stand for names."""
