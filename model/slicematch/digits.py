"""Numbers in sentences, to so many digits."""


def digits(value: float, count: int = 2) -> str:
    """A number to so many digits, never with an exponent for being large.

    Examples
    --------
    >>> digits(0.0123), digits(1.47), digits(99.6), digits(148.3), digits(12345.6, 4)
    ('0.012', '1.5', '100', '148', '12,346')
    """
    return f"{value:,.0f}" if abs(value) >= 10**count - 0.5 else f"{value:.{count}g}"
