"""An MJCF file together with every file that it names, as one text: what runs, what is hashed and
what a run folder keeps are the same bytes.

Includes are expanded, and every other file (meshes, textures, height fields, sub-models) is named
after its content, so that neither the place of a file nor the way in which it is found matters.
Numbers stay as they are written. Files are looked for as MuJoCo does
(https://mujoco.readthedocs.io/en/stable/XMLreference.html): an include in the folder of the main
file, then in that of the file that includes it; an asset in the compiler's ``meshdir``,
``texturedir`` or ``assetdir`` below the folder of the main file.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from hiltestbed.errors import Fault, InputError

if TYPE_CHECKING:
    import mujoco

# attributes that name a file; the latter are the sides of a cube texture
FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback")
# elements that are named after their file if they have no name
NAMED_AFTER = ("mesh", "texture", "hfield", "skin")
SETTINGS = ("option", "size", "visual", "statistic", "keyframe")  # those of a whole model
LARGEST = 500_000_000  # [byte] of all files of a model, chosen; 200,000 triangles take some 50 MB
KEPT = 32  # models that are kept in memory
DIGITS = 12  # of the hash in a file's name: 48 bits


@dataclass(frozen=True, eq=False)
class PackedMjcf:
    """An MJCF file with all that it names.

    Attributes:
        text: the MJCF. files: the content of every other file, by the name that the text has for
            it; they belong into the folder of the MJCF. sources: the files that were read.
    """

    text: str
    files: dict[str, bytes]
    sources: tuple[Path, ...] = ()

    @property
    def sha256(self) -> str:
        """The hash of the text, which names the other files by their content."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def spec(self) -> mujoco.MjSpec:
        """The model, as MuJoCo reads it from memory. Raises ValueError."""
        import mujoco

        models = {name: content for name, content in self.files.items() if name.endswith(".xml")}
        assets = {name: content for name, content in self.files.items() if name not in models}
        return mujoco.MjSpec.from_string(self.text, include=models, assets=assets)

    def part(self) -> PackedMjcf:
        """The same without the settings of a whole model, which a part of another does not have."""
        files = {
            name: _without_settings(content.decode()).encode() if name.endswith(".xml") else content
            for name, content in self.files.items()
        }
        return PackedMjcf(_without_settings(self.text), files, self.sources)

    def settings(self) -> list[str]:
        """The settings that :meth:`part` leaves out, as ``element attribute``."""
        root = ElementTree.fromstring(self.text)
        elements = [e for top in root if top.tag in ("option", "size") for e in top.iter()]
        return list(
            dict.fromkeys(f"{e.tag} {attribute}" for e in elements for attribute in e.attrib)
        )

    def write(self, folder: Path, name: str) -> Path:
        """Write the model to a new ``folder``, the MJCF as ``name``; returns its path."""
        folder.mkdir(parents=True)
        for other, content in self.files.items():
            (folder / other).write_bytes(content)
        (folder / name).write_text(self.text, encoding="utf-8")
        return folder / name


def packed(file: Path) -> PackedMjcf:
    """The model in an MJCF ``file``. Raises InputError if a file that it needs cannot be read."""
    found = _MEMORY.get(file)
    if found is None or found[0] != _state(found[1].sources):
        reader = _Reader()
        try:
            text = reader.model(file)
        except RecursionError:
            raise InputError(f"{file}: its elements are nested too deeply") from None
        sources = tuple(reader.sources)
        found = _state(sources), PackedMjcf(text, reader.files, sources)
        _MEMORY[file] = found
        while len(_MEMORY) > KEPT:
            _MEMORY.popitem(last=False)
    return found[1]


_MEMORY: OrderedDict[Path, tuple[object, PackedMjcf]] = OrderedDict()


def _state(files: tuple[Path, ...]) -> object:
    """What changes if one of the ``files`` does."""
    stats = map(_stat, files)
    return [None if s is None else (s.st_mtime_ns, s.st_size, s.st_ino) for s in stats]


def _stat(file: Path) -> os.stat_result | None:
    try:
        return file.stat()
    except (OSError, ValueError):
        return None


def _without_settings(text: str) -> str:
    root = ElementTree.fromstring(text)
    for element in [e for e in root if e.tag in SETTINGS]:
        root.remove(element)
    return ElementTree.tostring(root, encoding="unicode")


@dataclass
class _Reader:
    """Reads one model; ``files`` and ``sources`` as in :class:`PackedMjcf`."""

    files: dict[str, bytes] = field(default_factory=dict)
    sources: list[Path] = field(default_factory=list)
    size: int = 0

    def model(self, file: Path) -> str:
        """The text of the MJCF ``file``, its other files in ``files``."""
        root = self._parsed(file, str(file))
        self._expand(root, file, file, {file.resolve()})
        meshes = textures = Path()
        for compiler in root.iter("compiler"):
            where = compiler.attrib
            meshes = Path(where.get("meshdir", where.get("assetdir", str(meshes))))
            textures = Path(where.get("texturedir", where.get("assetdir", str(textures))))
        strips = any(c.get("strippath") == "true" for c in root.iter("compiler"))
        for element in root.iter():
            folder = {"texture": textures, "model": Path()}.get(element.tag, meshes)
            for key in FILES:
                if given := element.get(key):
                    name = Path(given).name if strips and element.tag != "model" else given
                    self._name(element, key, file, file.parent / folder / name)
            if element.tag == "compiler":
                for key in ("meshdir", "texturedir", "assetdir", "strippath"):
                    element.attrib.pop(key, None)
        for element in root.iter():
            element.text = element.tail = None
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode") + "\n"

    def _name(self, element: ElementTree.Element, key: str, by: Path, path: Path) -> None:
        """Name the file at ``path`` by its content in the attribute ``key`` of an element."""
        asked = f"{by}: {element.tag} {element.get('name', '')!r} names {element.get(key)!r}"
        if element.tag == "model":
            self._read(path, asked)
            content = self.model(path).encode()
        else:
            content = self._read(path, asked)
        digest = hashlib.sha256(content).hexdigest()[:DIGITS]
        stem = path.stem.removesuffix(f"-{digest}")
        if key == "file" and element.tag in NAMED_AFTER and not element.get("name"):
            element.set("name", stem)
        name = f"{stem}-{digest}{'.xml' if element.tag == 'model' else path.suffix}"
        self.files[name] = content
        element.set(key, name)

    def _expand(self, element: ElementTree.Element, main: Path, by: Path, seen: set[Path]) -> None:
        """Replace the includes below an ``element`` of the file ``by`` with what they include."""
        for child in list(element):
            if child.tag != "include":
                self._expand(child, main, by, seen)
                continue
            name = child.get("file", "")
            places = [main.parent / name, by.parent / name]
            path = next((p for p in places if _stat(p) is not None), places[0])
            if path.resolve() in seen:
                raise InputError(f"{by}: includes {name!r} again; a file is included once")
            seen.add(path.resolve())
            root = self._parsed(path, f"{by}: includes {name!r}")
            self._expand(root, main, path, seen)
            at = list(element).index(child)
            element[at : at + 1] = list(root)

    def _parsed(self, path: Path, asked: str) -> ElementTree.Element:
        try:
            return ElementTree.fromstring(self._read(path, asked))
        except ElementTree.ParseError as error:
            line, column = error.position
            reason = str(error).split(":")[0]
            what = f"is not a model that MuJoCo compiles, since it is no MJCF: {reason}"
            raise InputError(Fault(str(path), line, column + 1, "", what)) from None

    def _read(self, path: Path, asked: str) -> bytes:
        """The content of a file that was ``asked`` for. Raises InputError."""
        found = _stat(path)
        if found is None:
            looked = "" if asked == str(path) else f" (looked for {path})"
            raise InputError(f"{asked}: no such file{looked}")
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{asked}: {path} is no regular file; give a file with content")
        self.size += found.st_size
        if self.size > LARGEST:
            raise InputError(
                f"{asked}: with it the model has {self.size / 1e6:.0f} MB of files; at most "
                f"{LARGEST / 1e6:.0f} MB are read"
            )
        if path not in self.sources:
            self.sources.append(path)
        try:
            return path.read_bytes()
        except OSError as error:
            raise InputError(f"{asked}: cannot be read ({error.strerror})") from None
