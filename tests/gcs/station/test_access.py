"""What `cordon station` refuses before it listens: hosts, certificates and tokens that would let others in."""

import re
from pathlib import Path

import pytest

from gcs.errors import InputError
from gcs.keys.certificates import CertificateAuthority
from gcs.station.access import Access, camera_origins, checked_access, derived_secret, read_token
from gcs.viewer.origin_gate import Address

TOKEN = "0123456789abcdef"
HERE, BEYOND = Address("127.0.0.1", 8766), Address("0.0.0.0", 8766)


@pytest.fixture
def tls(tmp_path: Path) -> tuple[Path, Path]:
    keys = CertificateAuthority.made(1.0).issue("station", 4e9)
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    certificate.write_bytes(keys.certificate_pem)
    key.write_bytes(keys.private_key_pem)
    key.chmod(0o600)
    return certificate, key


def test_beyond_this_computer_both_a_certificate_and_a_token_are_needed(tls: tuple[Path, Path]) -> None:
    for given, token, missing in (
        (None, None, {"--tls", "--token-file"}),
        (tls, None, {"--token-file"}),
        (None, TOKEN, {"--tls"}),
    ):
        with pytest.raises(InputError) as refused:
            checked_access(BEYOND, token, given)
        assert {fault.partition(":")[0] for fault in refused.value.faults} == missing
    assert checked_access(BEYOND, TOKEN, tls).url.startswith("https://0.0.0.0:8766/#")
    assert Access(Address("::1", 80), TOKEN).origin == "http://[::1]:80"


def test_each_start_has_a_secret_and_on_this_computer_an_origin_of_its_own(tls: tuple[Path, Path]) -> None:
    for token in (None, TOKEN):
        first, second = (checked_access(HERE, token, None) for _ in range(2))
        assert first.secret != second.secret
        assert len(first.secret) >= 32
        assert first.origin != second.origin
        assert re.fullmatch(r"http://[0-9a-f]{16}\.localhost:8766/#[\w-]{32,64}", first.url)
        assert TOKEN not in first.url
        assert first.is_named([f"{first.name}:8766"])
    own = checked_access(BEYOND, TOKEN, tls)
    assert own.secret == derived_secret(TOKEN, own.salt)
    assert checked_access(HERE, None, tls).origin == "https://127.0.0.1:8766", "its certificate keeps others out"


def test_a_certificate_that_cannot_be_used_is_bad_input(tls: tuple[Path, Path], tmp_path: Path) -> None:
    for pair in ((tls[0], tls[0]), (tls[1], tls[0]), (tmp_path / "none", tls[1])):
        with pytest.raises(InputError, match="--tls"):
            checked_access(HERE, TOKEN, pair)
    tls[1].chmod(0o640)
    with pytest.raises(InputError, match=r"--tls: .*chmod 600"):
        checked_access(HERE, TOKEN, tls)


def test_a_token_is_long_and_closed_to_others(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    file.chmod(0o644)
    with pytest.raises(InputError, match="chmod 600"):
        read_token(file)
    file.chmod(0o600)
    assert read_token(file) == TOKEN
    for bad in (b"short", b"\xff" * 20, b"", TOKEN.encode() + b"\x00"):
        file.write_bytes(bad)
        with pytest.raises(InputError, match="--token-file"):
            read_token(file)


@pytest.mark.parametrize(
    ("address", "hosts", "is_named"),
    [
        (HERE, ["127.0.0.1:8766"], True),
        (HERE, ["LOCALHOST"], True),
        (HERE, ["[::1]:8766"], True),
        (HERE, ["0123.localhost:8766"], True),
        (HERE, ["192.168.1.2:8766"], False),
        (HERE, ["evil.example:8766"], False),
        (HERE, ["127.0.0.1", "127.0.0.1"], False),
        (HERE, [], False),
        (HERE, ["[::1"], False),
        (HERE, ["user@evil.example"], False),
        (BEYOND, ["192.168.1.2:8766"], True),
        (BEYOND, ["[fe80::1]:8766"], True),
        (BEYOND, ["evil.example"], False),
        (BEYOND, ["0123.localhost"], False),
        (BEYOND, ["192.168.1.2.evil.example"], False),
        (Address("station.example", 443), ["Station.Example"], True),
        (Address("station.example", 443), ["evil.example"], False),
    ],
)
def test_only_names_of_this_computer_count(address: Address, hosts: list[str], is_named: bool) -> None:
    assert Access(address, TOKEN).is_named(hosts) is is_named


def test_the_page_shows_pictures_of_its_missions_cameras_alone() -> None:
    streams = [
        "http://10.0.0.7:8080/video?a=b",
        "",
        "rtsp://10.0.0.8/main",
        "https://[fd00::1]/x",
        "http://a;script-src/",
    ]
    access = Access(HERE, TOKEN, cameras=camera_origins(streams))
    policy = dict(part.strip().split(" ", 1) for part in access.content_policy.split(";"))
    assert policy["img-src"] == "'self' data: blob: http://10.0.0.7:8080 https://[fd00::1]"
    assert policy["script-src"] == policy["connect-src"] == "'self'"
