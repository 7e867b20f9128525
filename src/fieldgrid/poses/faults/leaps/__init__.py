"""Leaps of the solution of a receiver, and what each sensor says of them."""
