"""The authority's private key on a PKCS#11 token: SoftHSM's, by CORDON_SOFTHSM2 or where Debian installs it."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from gcs.errors import Exit, InputError
from gcs.keys.authority_folder import AuthorityFolder
from tests.conftest import RunHere
from tests.gcs.keys.test_key_folder import security_of

MODULE = Path(os.environ.get("CORDON_SOFTHSM2", "/usr/lib/softhsm/libsofthsm2.so"))
PIN = b"1234"


@pytest.fixture
def uri(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the URI of a key, which is still to be created, on a new token."""
    pkcs11 = pytest.importorskip("pkcs11", reason="python-pkcs11 is not installed: pip install 'cordon-gcs[token]'")
    util = shutil.which("softhsm2-util")
    if util is None or not MODULE.exists():
        pytest.skip(f"SoftHSM is not installed: neither softhsm2-util nor {MODULE}")
    (tmp_path / "tokens").mkdir()
    settings = tmp_path / "softhsm2.conf"
    settings.write_text(f"directories.tokendir = {tmp_path / 'tokens'}\n")
    monkeypatch.setenv("SOFTHSM2_CONF", str(settings))
    init = [util, "--module", str(MODULE), "--init-token", "--free", "--label", "cordon"]
    subprocess.run([*init, "--pin", PIN.decode(), "--so-pin", "5678"], check=True, capture_output=True)
    pkcs11.lib(str(MODULE)).reinitialize()
    return f"pkcs11:token=cordon;object=authority?module-path={MODULE}"


def test_an_authority_on_a_token_issues_and_revokes(uri: str, tmp_path: Path, subtests: pytest.Subtests) -> None:
    keys = AuthorityFolder(tmp_path / "keys", lambda: PIN)
    keys.init(10.0, token=uri)
    private = keys.path / "authority" / "private-key.pem"
    assert private.read_text() == uri
    keys.issue("vehicle", "3", 1.0)
    keys.issue("operator", "bob", 1.0)
    keys.revoke("operator-bob")
    assert [grant.common_name for grant in security_of(keys, "vehicle", "3").grants] == ["vehicle-3"]
    openssl = ["openssl", "verify", "-CAfile", str(keys.path / "authority" / "certificate.pem")]
    if shutil.which("openssl") is not None:
        subprocess.run([*openssl, str(keys.path / "vehicle-3" / "certificate.pem")], check=True, capture_output=True)
    with subtests.test("a wrong PIN"), pytest.raises(InputError, match="PinIncorrect"):
        AuthorityFolder(keys.path, lambda: b"9999").issue("vehicle", "4", 1.0)
    with subtests.test("a passphrase"), pytest.raises(InputError, match="on a token"):
        keys.encrypt(lambda: b"new")
    with subtests.test("a second authority of the same name"), pytest.raises(InputError, match="already"):
        AuthorityFolder(tmp_path / "others", lambda: PIN).init(10.0, token=uri)
    assert time.time() < keys.roster.holders[0].expires_s


def test_what_is_wrong_with_a_token_is_named(
    uri: str, tmp_path: Path, run_here: RunHere, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    monkeypatch.setenv("CORDON_KEYS_PASSPHRASE", PIN.decode())
    wrong = {
        "not of the form": "file:/tmp/key",
        "NoSuchToken": uri.replace("cordon", "other"),
        "missing.so": uri.replace(str(MODULE), str(tmp_path / "missing.so")),
    }
    for words, given in wrong.items():
        with subtests.test(words=words):
            code, _, err = run_here("keys", "init", "--token", given, "--keys", str(tmp_path / "keys"))
            assert code == Exit.BAD_INPUT
            assert words in err.replace("\n", "")
            assert not (tmp_path / "keys").exists()
