"""Metadata of the installed package."""

from importlib.metadata import distribution
from importlib.resources import files

import palpate


def test_the_version_is_that_of_the_metadata() -> None:
    assert palpate.__version__ == distribution("palpate").version


def test_type_checkers_find_that_the_package_is_typed() -> None:
    assert (files("palpate") / "py.typed").is_file()


def test_both_licences_come_with_the_package() -> None:
    metadata = distribution("palpate").metadata
    assert metadata["License-Expression"] == "MIT OR Apache-2.0"
    assert sorted(metadata.get_all("License-File", [])) == ["LICENSE-APACHE", "LICENSE-MIT"]
    for name in ("LICENSE-APACHE", "LICENSE-MIT"):
        text = distribution("palpate").read_text(f"licenses/{name}")
        assert text and "opyright" in text
