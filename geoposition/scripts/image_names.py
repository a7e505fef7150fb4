"""How tables name images: by id, by file name, by stem, or by their place, counted from 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoposition.arrays import IntArray
from geoposition.errors import ProductError
from geoposition.scripts.tables import Column


@dataclass(frozen=True, slots=True)
class ImageNames:
    """Names of images (in order): `ids` first, then files, of which only those that are unique.

    `others` are further files of an image, such as the picture beside its metadata.
    """

    ids: tuple[str, ...]
    files: tuple[Path, ...]
    others: tuple[tuple[Path, ...], ...] = ()

    @classmethod
    def of_products(cls, products: Sequence[Path]) -> ImageNames:
        """Products of a command line: they have no ids beside their files' names."""
        return cls((), tuple(products))

    def numbers(self) -> dict[str, int]:
        """Every name that means one image."""
        known: dict[str, int] = {}
        for spelled in (lambda p: p.stem, lambda p: p.name, str):
            for files in (self.others, tuple((path,) for path in self.files)):
                seen: dict[str, set[int]] = {}
                for i, paths in enumerate(files):
                    for path in paths:
                        seen.setdefault(spelled(path), set()).add(i)
                known |= {name: where.pop() for name, where in seen.items() if len(where) == 1}
        known = {str(i): i for i in range(len(self.files))} | known
        return known | {name: i for i, name in enumerate(self.ids)}

    def number_of(self, path: Path, name: str) -> int:
        """Image called `name` in the file `path`; an unknown one is a `ProductError`."""
        return int(self.numbers_of(path, np.array([name]))[0])

    def numbers_of(self, path: Path, names: Column) -> IntArray:
        """Images (n,) called `names` (n,) in the file `path`.

        An empty name means the only image there is. A folder before a name is left away where
        the whole of it means nothing.
        """
        known = self.numbers()
        if len(self.files) == 1:
            known[""] = 0
        unique, inverse = np.unique(
            np.char.strip(np.asarray(names, dtype=np.str_)), return_inverse=True
        )
        short = {str(name): str(name) for name in unique}
        short |= {name: Path(name).name for name in short if name not in known}
        short |= {name: Path(text).stem for name, text in short.items() if text not in known}
        unknown = [name for name, text in short.items() if text not in known]
        if unknown:
            places = map(str, range(len(self.files)))
            told = ", ".join(dict.fromkeys([*self.ids, *places, *map(str, self.files)]))
            raise ProductError(path, f"product {unknown[0]!r}", f"one of these expected: {told}")
        found: IntArray = np.array([known[short[str(n)]] for n in unique], dtype=np.int64)
        return found[inverse] if len(found) else np.empty(0, dtype=np.int64)
