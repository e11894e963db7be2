"""Pictures of the gallery: the picture files that an example script writes into its own folder."""

import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst


def saved_pictures(_block, block_vars, gallery_conf) -> str:
    """Move pictures that a code block of an example has written, from its folder to the gallery's folder.

    sphinx-gallery calls this function after each code block. The function returns reStructuredText that shows the
    pictures.
    """
    folder = Path(block_vars["src_file"]).parent
    shown = []
    paths = sorted(path for suffix in ("png", "webp", "gif") for path in folder.glob(f"*.{suffix}"))
    for path in paths:
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(path.suffix)
        shutil.move(path, target)
        shown.append(str(target))
    return figure_rst(shown, gallery_conf["src_dir"])
