"""Text that comes from a file, a message or another host, made safe to print."""


def printable(text: str) -> str:
    """Return a text in which every character that a terminal would obey, line ends included, is a question mark."""
    return text if text.isprintable() else "".join(letter if letter.isprintable() else "?" for letter in text)


def printable_lines(text: str) -> str:
    """Return a text of one or several lines in which no line commands a terminal; tabs become spaces."""
    return "\n".join(printable(line.expandtabs()) for line in text.split("\n"))
