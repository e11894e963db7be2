"""Pictures of the gallery: the files that an example saves beside itself."""

import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst


class SavedPictures:
    """Scraper of sphinx-gallery that shows each picture file once that a block of an example has written."""

    def __repr__(self) -> str:
        return "SavedPictures"

    def __call__(self, _block, block_vars, gallery_conf) -> str:
        """Move new pictures to the gallery, and return the reStructuredText that shows them."""
        folder = Path(block_vars["src_file"]).parent
        shown = []
        paths = sorted(path for suffix in ("png", "webp", "gif") for path in folder.glob(f"*.{suffix}"))
        for path in paths:
            target = Path(next(block_vars["image_path_iterator"])).with_suffix(path.suffix)
            shutil.move(path, target)
            shown.append(str(target))
        return figure_rst(shown, gallery_conf["src_dir"])
