"""Templates of `fleet new`: files that run at once; TheLaw, the_law and the_scenario in them stand for names."""
