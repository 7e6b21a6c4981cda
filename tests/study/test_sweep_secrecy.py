"""Local workers of a sweep open no port; a cluster with TLS accepts only known certificates."""

from __future__ import annotations

import datetime
from pathlib import Path

import psutil
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from helpers_study import dask_over_tcp
from test_study_sweep import write_sweep

import nacre
from nacre.analysis.sweep import load_sweep, run_sweep
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers

Authority = tuple[x509.Certificate, ec.EllipticCurvePrivateKey]


def listening() -> list[tuple[str, int]]:
    """Return the addresses at which this process and its children wait for connections."""
    found = set()
    for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
        try:
            connections = process.net_connections(kind="inet")
        except psutil.Error:
            continue
        found |= {(c.laddr.ip, c.laddr.port) for c in connections if c.status == psutil.CONN_LISTEN}
    return sorted(found)


def test_local_workers_open_no_port(tmp_path: Path) -> None:
    sweep = load_sweep(write_sweep(tmp_path, 40))
    before, seen = set(listening()), set()

    def progress(done: int, failed: int, total: int) -> None:
        seen.update(listening())

    assert run_sweep(sweep, tmp_path / "s.zarr", workers=Workers(2), progress=progress) == (sweep.points.count, 0)
    assert seen <= before


def authority(name: str) -> Authority:
    key = ec.generate_private_key(ec.SECP256R1())
    return signed(name, key, None, key), key


def signed(
    name: str, key: ec.EllipticCurvePrivateKey, by: x509.Certificate | None, by_key: ec.EllipticCurvePrivateKey
) -> x509.Certificate:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(tz=datetime.UTC)
    builder = x509.CertificateBuilder(
        by.subject if by is not None else subject, subject, key.public_key(), x509.random_serial_number(),
        now - datetime.timedelta(hours=1), now + datetime.timedelta(days=1),
    )  # fmt: skip
    builder = builder.add_extension(x509.BasicConstraints(ca=by is None, path_length=None), critical=True)
    return builder.sign(by_key, hashes.SHA256())


def write_pair(folder: Path, name: str, ca: Authority) -> None:
    """Write `NAME.pem` and `NAME-key.pem`, signed by an authority, and its `ca.pem`."""
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = signed(name, key, ca[0], ca[1])
    folder.mkdir(exist_ok=True)
    (folder / "ca.pem").write_bytes(ca[0].public_bytes(serialization.Encoding.PEM))
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    (folder / f"{name}-key.pem").write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )


def write_security(folder: Path) -> Path:
    path = folder / "security.toml"
    path.write_text('ca = "ca.pem"\ncert = "client.pem"\nkey = "client-key.pem"\n')
    return path


@pytest.mark.full
def test_a_cluster_of_ones_own_takes_the_key_that_it_knows_and_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nacre.core.jobs.CONNECT_TIMEOUT_S", 5)
    ours, theirs = authority("ours"), authority("theirs")
    for name in ("cluster", "client"):
        write_pair(tmp_path / "keys", name, ours)
    write_pair(tmp_path / "strange", "client", theirs)
    keys = tmp_path / "keys"
    tls = ("--tls-ca-file", keys / "ca.pem", "--tls-cert", keys / "cluster.pem", "--tls-key", keys / "cluster-key.pem")
    path = write_sweep(tmp_path, 4)
    with dask_over_tcp(tmp_path, 1, *map(str, tls), protocol="tls") as address:
        assert address.startswith("tls://")
        strange = write_security(tmp_path / "strange")
        for security in ((), ("--security", str(strange))):
            line = ["sweep", str(path), "-o", str(tmp_path / "no.zarr"), "--cluster", address, *security]
            assert run(line) == 2
            error = capsys.readouterr().err.strip().splitlines()[-1]
            assert error.startswith(f"nacre: --cluster {address}: ")
        store = nacre.sweep(path, tmp_path / "s.zarr", cluster=address, security=write_security(keys))
    assert run_sweep(load_sweep(path), store)[1] == 0 and (store / "zarr.json").exists()


@pytest.mark.parametrize(
    ("text", "files", "named"),
    [
        (None, {}, "security.toml: does not exist"),
        ('ca = "ca.pem"\ncert = "client.pem"\n', {}, "key"),
        ('ca = "ca.pem"\ncert = "client.pem"\nkeys = "client-key.pem"\n', {}, "keys"),
        ("ca = [", {}, "security.toml"),
        (None, {"client-key.pem": None}, 'key = "client-key.pem" cannot be read: No such file or directory'),
        (None, {"ca.pem": "no certificate"}, "ca cannot be used"),
        (None, {"client.pem": "no certificate"}, "cert and key cannot be used"),
        (None, {"client-key.pem": "no key"}, "cert and key cannot be used"),
    ],
)
def test_a_security_file_that_cannot_be_used_is_one_line(
    text: str | None, files: dict[str, str | None], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_pair(tmp_path, "client", authority("ours"))
    path = tmp_path / "security.toml"
    if text is not None:
        path.write_text(text)
    elif files:
        write_security(tmp_path)
    for name, content in files.items():
        (tmp_path / name).unlink()
        if content is not None:
            (tmp_path / name).write_text(content)
    sweep = write_sweep(tmp_path, 2)
    assert run(["sweep", str(sweep), "--cluster", "tls://127.0.0.1:1", "--security", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and named in lines[0], lines


def test_a_security_file_without_its_scheduler_is_refused(tmp_path: Path) -> None:
    write_pair(tmp_path, "client", authority("ours"))
    path = write_security(tmp_path)
    with pytest.raises(NacreError, match="belongs to --cluster"):
        nacre.sweep(write_sweep(tmp_path, 2), tmp_path / "s.zarr", security=path)
    with pytest.raises(NacreError, match="the address begins with tls://"):
        nacre.sweep(write_sweep(tmp_path, 2), tmp_path / "s.zarr", cluster="tcp://127.0.0.1:1", security=path)
