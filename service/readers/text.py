"""Text files as lines."""

from pathlib import Path

from service.readers.errors import FileError

WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")


def read_bytes(path: str | Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    FileError
        If it cannot be read or is empty.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from None
    if not content.strip(b"\xef\xbb\xbf \t\r\n\x00"):
        raise FileError(path, "the file is empty")
    return content


def lines_of(path: str | Path, content: bytes, *, strict: bool = True) -> list[str]:
    """Return the lines of a text, without their ends and without a byte order mark.

    Parameters
    ----------
    strict
        Refuse what is not UTF-8; otherwise such characters are replaced, as titles in older files need.

    Raises
    ------
    FileError
        If it is not text.
    """
    if content.startswith(WIDE_MARKS):
        raise FileError(path, "the file is UTF-16; save it as UTF-8")
    if b"\x00" in content:
        raise FileError(
            path, "not a text file: it holds zero bytes", content.count(b"\n", 0, content.index(b"\x00")) + 1
        )
    try:
        text = content.decode("utf-8-sig", "strict" if strict else "replace")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(path, "not a text file in UTF-8", line) from None
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
