"""Makes text from a file, a message or another host safe to print."""


def printable(text: str) -> str:
    """Return a text with every control character, line ends included, replaced by a question mark."""
    return text if text.isprintable() else "".join(letter if letter.isprintable() else "?" for letter in text)


def printable_lines(text: str) -> str:
    """Return a text of several lines with `printable` applied to each; tabs become spaces."""
    return "\n".join(printable(line.expandtabs()) for line in text.split("\n"))
