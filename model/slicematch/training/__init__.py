"""Training: the loss, the loop, and what is written down on the way."""
