"""A self-signed certificate for 127.0.0.1, made by openssl."""

import shutil
import ssl
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest


@dataclass(frozen=True)
class Certificate:
    """Files of a self-signed certificate for 127.0.0.1."""

    certificate: Path
    key: Path

    @property
    def settings(self) -> dict[str, str]:
        """Settings of a service that uses this certificate."""
        return {"tls_certificate": str(self.certificate), "tls_key": str(self.key)}

    def trusted(self) -> ssl.SSLContext:
        """Return a TLS context that trusts this certificate."""
        return ssl.create_default_context(cafile=str(self.certificate))


def make_certificate(folder: Path) -> Certificate:
    """Make a certificate; skip the test if openssl is not installed."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificate")
    made = Certificate(folder / "certificate.pem", folder / "key.pem")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(made.key), "-out", str(made.certificate)]
    subprocess.run(command, check=True, capture_output=True)
    return made
