"""Certificates that tests of several hosts share."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.addons.hosts import certificates


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("pki") / "certs"
    certificates.make(directory, ["Sea.example.org", "192.0.2.7", "2001:db8::7"], agents=2)
    return directory
