"""Finds the files that ship with the program: protocols, calibrations, rigs.

One rule for every name: the path as given comes first, then the shipped file
of that name. A checkout uses the folders at its top; an installed program the
copies inside its own package.
"""

from __future__ import annotations

from pathlib import Path

from piezo_rig.errors import InputError

_SUFFIXES = {
    "protocols": (".toml",),
    "configs": (".toml",),
    "calibration": (".toml",),
    "models": (".json",),
}
_FOLDERS = {"models": "calibration"}  # where it is not of the kind's own name


def shipped_folder(kind: str) -> Path:
    """The folder of the shipped files of one kind.

    ``protocols``, ``configs``, ``calibration`` (of instruments) or ``models``.
    """
    package = Path(__file__).resolve().parent
    name = _FOLDERS.get(kind, kind)
    installed = package / "shipped" / name
    return installed if installed.is_dir() else package.parent / name


def shipped_names(kind: str) -> list[str]:
    """Names of the shipped files of one kind, without their suffix."""
    folder = shipped_folder(kind)
    return sorted(p.stem for suffix in _SUFFIXES[kind] for p in folder.glob("*" + suffix))


def find(kind: str, name: str, beside: Path | None = None) -> Path:
    """The file that ``name`` means.

    Parameters
    ----------
    kind : ``protocols``, ``configs``, ``calibration`` or ``models``
    name : a path, or the name of a shipped file with or without its suffix
    beside : a folder that relative paths may also start from (that of the config which names it)

    Raises
    ------
    InputError : nothing is found; lists what is shipped
    """
    given = Path(name)
    candidates = [given]
    if beside is not None and not given.is_absolute():
        candidates.append(beside / given)
    if given.parent == Path("."):
        shipped = shipped_folder(kind) / given.name
        candidates += [shipped]
        candidates += [shipped.with_name(given.name + suffix) for suffix in _SUFFIXES[kind]]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    if given.is_dir():
        raise InputError(
            "file-missing", f"{name}: a folder, not a file", "a slip in the name", "give a file"
        )
    raise InputError(
        "file-missing",
        f"{name}: no such file, and no shipped one of that name in {kind}",
        "a slip in the name, or another folder than you think",
        f"give a path, or one of: {', '.join(shipped_names(kind)) or '(none shipped)'}",
    )


def read_text(path: Path, what: str) -> str:
    """The UTF-8 text of a small file; every failure is an ``InputError``."""
    try:
        if path.stat().st_size > 5_000_000:
            raise InputError(
                "file-size",
                f"{path}: {path.stat().st_size} bytes is too large for {what}",
                "a recording where a settings file was expected",
                f"give a {what}",
            )
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            "file-text", f"{path}: not UTF-8 text (byte {error.start})",
            f"not a {what}", f"give a {what}",
        ) from None
    except OSError as error:
        raise InputError(
            "file-unreadable", f"{path}: {error.strerror or error}",
            "the file is missing, a folder, or not yours to read", f"give a readable {what}",
        ) from None
