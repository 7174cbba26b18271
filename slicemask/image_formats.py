"""Which image formats are read, and what a file is that is none of them."""

from pathlib import Path

# Plain raster formats only: Pillow hands some others to outside programs.
FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
FORMATS_TEXT = "JPEG, PNG, WebP, BMP or TIFF"

# How files of other formats begin, from which byte on.
_IMAGES = (
    (0, b"\0\0\0\x0cjP  ", "a JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "a JPEG 2000"),
    (0, b"\0\0\0\x0cJXL ", "a JPEG XL"),
    (0, b"\xff\x0a", "a JPEG XL"),
    (4, b"ftypavi", "an AVIF"),
    (4, b"ftyphei", "a HEIC"),
    (4, b"ftyphev", "a HEIC"),
    (4, b"ftypmif1", "a HEIF"),
    (4, b"ftypmsf1", "a HEIF"),
    (4, b"ftypcrx", "a Canon raw"),
    (0, b"FUJIFILMCCD-RAW", "a Fujifilm raw"),
    (0, b"GIF8", "a GIF"),
    *((0, b"P%d" % number, "a PPM") for number in range(1, 8)),
    (0, b"Pf", "a PFM"),
    (0, b"PF", "a PFM"),
    (0, b"DDS ", "a DDS"),
    (0, b"icns", "an ICNS"),
    (0, b"\0\0\1\0", "an ICO"),
    (0, b"\x01\xda", "an SGI"),
    (0, b"#?RADIANCE", "a Radiance HDR"),
    (0, b"v/1\x01", "an OpenEXR"),
    (0, b"8BPS", "a Photoshop"),
    (0, b"%!PS", "a PostScript"),
    (0, b"%PDF", "a PDF"),
    (0, b"<svg", "an SVG"),
)
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_NO_IMAGES = (
    (0, b"version https://git-lfs", "a Git LFS pointer", "fetch the image itself (git lfs pull)"),
    (0, b"<!doctype html", "a web page", "download the image itself"),
    (0, b"<html", "a web page", "download the image itself"),
    (0, b"\x93numpy", "a NumPy array", "save it as PNG, or hand it over as an array in Python"),
    (0, b"\x89hdf", "an HDF5 file", "name an image"),
    (0, b"pk\x03\x04", "a ZIP archive", "unpack it, and name an image in it"),
    (0, b"\x1f\x8b", "a gzip archive", "unpack it, and name an image in it"),
    (4, b"ftyp", "a video", "save one frame of it as an image"),
)


def why_no_file(path: Path) -> str:
    """One sentence on a path that names no file."""
    if path.is_dir():
        return f"{path}: is a folder; name one image in it"
    if path.exists():
        return f"{path}: is no regular file; save the image to a file, and name that"
    if path.parts and path.parts[0] in ("http:", "https:", "s3:", "gs:", "ftp:"):
        return f"{path}: addresses are not fetched; download the image, and name its file"
    if any(sign in str(path) for sign in "*?["):
        return f"{path}: there is no such image; name one image, since patterns are not expanded"
    return f"{path}: there is no such image; check the name"


def why_no_image(path: Path, reason: str, unidentified: bool) -> str:
    """One sentence on a file that is unreadable as an image.

    Parameters
    ----------
    path : Path
        The file.
    reason : str
        What the decoder said.
    unidentified : bool
        Whether the file is of no kind that is read, rather than a damaged one.

    Returns
    -------
    str
        With a remedy that fits what the file begins with.
    """
    with path.open("rb") as file:
        head = file.read(32)
    for start, mark, name in _IMAGES:
        if head[start:].startswith(mark):
            return f"{path}: is {name} file, which is not read; convert it to {FORMATS_TEXT}"
    for start, mark, name, remedy in _NO_IMAGES:
        if head[start:].lower().startswith(mark):
            return f"{path}: is {name}, not an image; {remedy}"
    if unidentified and head.startswith(_TIFF):
        return (
            f"{path}: is a TIFF file of a kind that is not read, such as one of floating-point or "
            "signed values or of two or more than four bands; convert it to RGB of 8 or 16 "
            "unsigned bits a channel"
        )
    return (
        f"{path}: is unreadable as an image ({reason}); it may be cut short or altered, or no "
        f"{FORMATS_TEXT} file"
    )
