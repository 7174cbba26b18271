"""A page on a trained run: its answers, and what each slice and band adds to a pose's score."""
