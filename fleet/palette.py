"""Colours that everybody can tell apart, in pictures and in 3D viewers."""

# Okabe and Ito's palette without its yellow, which vanishes on white: distinct in print and with any colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#56B4E9", "#E69F00")
