"""Takes the pictures that a program of the gallery wrote beside itself into its page."""

from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst


def written(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move PNG and GIF files to the page, in the order in which they were written."""
    folder = Path(block_vars["src_file"]).parent
    files = [file for suffix in (".png", ".gif") for file in folder.glob(f"*{suffix}")]
    names = []
    for file in sorted(files, key=lambda file: file.stat().st_mtime_ns):
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(file.suffix)
        names.append(str(file.replace(target)))
        file.with_suffix(".svg").unlink(missing_ok=True)  # `save` writes both.
    return figure_rst(names, gallery_conf["src_dir"])


def _get_sg_image_scraper() -> Any:
    """What sphinx-gallery calls to find the function."""
    return written
