"""Make everything that a shared airspace needs: broker configuration, certificates, passwords, access list, credentials.

    python scripts/make_airspace.py FOLDER --area field --host broker.local --operator alice=red,green --operator bob=blue

FOLDER/broker is for the computer of the broker; each FOLDER/*.json is the secret of one operator, drone or authority and
goes to whom it names, and to nobody else. Needs openssl and mosquitto_passwd (Debian: openssl, mosquitto).
"""

from __future__ import annotations

import argparse
import getpass
import ipaddress
import json
import os
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

TEMPLATE = Path(__file__).resolve().parents[1] / "config" / "airspace" / "mosquitto.conf"
NAME = re.compile(r"[a-z][a-z0-9_-]{0,31}")
ROOT = "m3r/1"


class CannotMake(Exception):  # noqa: N818
    """One sentence."""


def main(arguments: list[str] | None = None) -> int:
    """Make the folder; 2 and one sentence if that cannot be."""
    parser = argparse.ArgumentParser(description="Make the broker's configuration and everybody's credentials.")
    parser.add_argument("folder", type=Path, help="made anew; nothing is overwritten")
    parser.add_argument("--area", default="field", help="name of the area that one authority looks after (field)")
    parser.add_argument("--host", action="append", help="name or address of the broker's computer (localhost)")
    parser.add_argument("--port", type=int, help="of the broker (8883, or 1883 without TLS)")
    parser.add_argument("--operator", action="append", required=True, metavar="NAME=DRONE,...", help="who may fly what")
    parser.add_argument("--drone", action="append", default=[], metavar="NAME", help="a drone that no operator flies")
    parser.add_argument("--days", type=int, default=90, help="how long the certificates hold (90)")
    parser.add_argument("--no-tls", action="store_true", help="only for a broker and apps on one computer")
    options = parser.parse_args(arguments)
    try:
        make(
            options.folder,
            area=_name(options.area, "--area"),
            hosts=options.host or ["localhost", "127.0.0.1"],
            port=options.port or (1883 if options.no_tls else 8883),
            operators=_operators(options.operator),
            drones=[_name(drone, "--drone") for drone in options.drone],
            days=options.days,
            tls=not options.no_tls,
        )
    except CannotMake as error:
        print(f"make_airspace: {error}", file=sys.stderr)
        return 2
    return 0


def make(
    folder: Path,
    *,
    area: str,
    hosts: list[str],
    port: int,
    operators: dict[str, list[str]],
    drones: Iterable[str] = (),
    days: int = 90,
    tls: bool = True,
) -> None:
    """The whole folder, or nothing. Raises CannotMake."""
    if not 1 <= port <= 65535:
        raise CannotMake(f"--port {port} is no port: give a number from 1 to 65535")
    if not 1 <= days <= 3650:
        raise CannotMake(f"--days {days} is not between 1 and 3650")
    if not tls and any(host not in ("localhost", "127.0.0.1", "::1") for host in hosts):
        raise CannotMake("without TLS passwords would cross the network in clear: leave out --no-tls, or --host")
    for tool in ("mosquitto_passwd", *(["openssl"] if tls else [])):
        if shutil.which(tool) is None:
            raise CannotMake(f"{tool} is not installed (Debian: apt install mosquitto openssl)")
    if folder.exists():
        raise CannotMake(f"{folder} is there already: name a new folder, or delete it (all credentials change)")
    everybody = sorted({*drones, *(drone for flown in operators.values() for drone in flown)})
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as made:
            _fill(Path(made), folder, area, hosts, port, operators, everybody, days, tls)
            Path(made).chmod(0o700)
            Path(made).rename(folder)
            Path(made).mkdir()  # for the context to remove
    except OSError as error:
        raise CannotMake(f"{folder} cannot be made: {error.strerror}") from None


def _fill(
    made: Path,
    folder: Path,
    area: str,
    hosts: list[str],
    port: int,
    operators: dict[str, list[str]],
    drones: list[str],
    days: int,
    tls: bool,
) -> None:
    broker = made / "broker"
    broker.mkdir(mode=0o700)
    ca = _certificates(broker, made, area, hosts, days) if tls else None
    users = [f"airspace.{area}", *(f"operator.{o}" for o in operators), *(f"drone.{d}" for d in drones)]
    passwords = {user: secrets.token_urlsafe(24) for user in users}
    keys = {user: secrets.token_hex(32) for user in users}
    hashed = broker / "passwords"
    _write(hashed, "".join(f"{user}:{password}\n" for user, password in passwords.items()))
    _run("mosquitto_passwd", "-U", str(hashed))
    hashed.chmod(0o600)
    _write(broker / "access", access_list(area, operators, drones))
    local = all(host in ("localhost", "127.0.0.1", "::1") for host in hosts)
    # Mosquitto needs whole names, and it reads them where the folder ends up.
    there = folder.resolve() / "broker"
    lines = f"certfile {there}/server.crt\nkeyfile {there}/server.key\ntls_version tlsv1.2\n" if tls else ""
    filled = {
        "@USER@": getpass.getuser(),
        "@PORT@": str(port),
        "@ADDRESS@": "127.0.0.1" if local else "",
        "@TLS@": lines,
    }
    text = TEMPLATE.read_text(encoding="utf-8")
    for mark, value in {**filled, "@FOLDER@": str(there)}.items():
        text = text.replace(mark, value)
    _write(broker / "mosquitto.conf", text)
    drone_keys = {f"drone.{d}": keys[f"drone.{d}"] for d in drones}
    for user in users:
        role, _, name = user.partition(".")
        known = {user: keys[user]}
        if role == "operator":
            known |= drone_keys | {f"airspace.{area}": keys[f"airspace.{area}"]}
        elif role == "airspace":
            known |= {f"operator.{o}": keys[f"operator.{o}"] for o in operators}
        flies = operators[name] if role == "operator" else [name] if role == "drone" else []
        secret = {"user": user, "password": passwords[user], "area": area, "ca": ca, "flies": flies, "keys": known}
        _write(made / f"{user}.json", json.dumps(secret, indent=1) + "\n")


def access_list(area: str, operators: dict[str, list[str]], drones: Iterable[str]) -> str:
    """Who may publish and hear what, as Mosquitto's acl_file."""
    lines = [
        "# Claims and volumes are granted by one authority; an operator asks in his own name, for his drones.",
        f"user airspace.{area}",
        f"topic read {ROOT}/ask/{area}/+/+",
        f"topic write {ROOT}/answer/+/+",
        f"topic readwrite {ROOT}/held/{area}",
    ]
    for operator, flown in operators.items():
        lines += ["", f"user operator.{operator}", f"topic read {ROOT}/held/{area}"]
        lines += [f"topic read {ROOT}/answer/{operator}/+", f"topic read {ROOT}/state/+/+"]
        lines += [f"topic write {ROOT}/ask/{area}/{drone}/{operator}" for drone in flown]
        lines += [f"topic write {ROOT}/state/+/{drone}" for drone in flown]
    for drone in drones:
        lines += ["", f"user drone.{drone}", f"topic readwrite {ROOT}/state/+/{drone}"]
    return "\n".join(lines) + "\n"


def _certificates(broker: Path, made: Path, area: str, hosts: list[str], days: int) -> str:
    """A maker of certificates for this airspace alone, and the broker's certificate by it. Returns the maker's, PEM."""
    names = ",".join(f"IP:{host}" if _is_address(host) else f"DNS:{host}" for host in hosts)
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    maker, asked, extensions = made / "ca.key", broker / "server.csr", broker / "extensions"
    _run(
        *("openssl", "req", "-x509", *key, "-keyout", str(maker), "-out", str(broker / "ca.crt")),
        *("-days", str(days), "-subj", f"/CN=m3r airspace {area}", "-addext", "keyUsage=critical,keyCertSign,cRLSign"),
    )
    _run(
        *("openssl", "req", "-new", *key, "-keyout", str(broker / "server.key"), "-out", str(asked)),
        *("-subj", f"/CN={hosts[0]}"),
    )
    _write(
        extensions,
        f"subjectAltName={names}\nbasicConstraints=critical,CA:FALSE\nkeyUsage=critical,digitalSignature\n"
        "extendedKeyUsage=serverAuth\nsubjectKeyIdentifier=hash\nauthorityKeyIdentifier=keyid\n",
    )
    _run(
        *("openssl", "x509", "-req", "-in", str(asked), "-CA", str(broker / "ca.crt"), "-CAkey", str(maker)),
        *("-CAcreateserial", "-days", str(days), "-extfile", str(extensions), "-out", str(broker / "server.crt")),
    )
    for scrap in (asked, extensions, *broker.glob("*.srl"), *made.glob("*.srl")):
        scrap.unlink(missing_ok=True)
    return (broker / "ca.crt").read_text(encoding="ascii")


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise CannotMake(f"{words[0]} failed: {last}")


def _write(path: Path, text: str) -> None:
    """Readable by its owner alone from the first moment."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
        file.write(text)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        if not re.fullmatch(r"[A-Za-z0-9.-]{1,253}", host):
            raise CannotMake(f"--host {host!r} is no name of a computer") from None
        return False
    return True


def _name(text: str, option: str) -> str:
    if not NAME.fullmatch(text):
        raise CannotMake(f"{option} {text!r}: use a word of small letters and digits, such as red")
    return text


def _operators(texts: list[str]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for text in texts:
        name, equals, flown = text.partition("=")
        if not equals or not flown:
            raise CannotMake(f"--operator {text} is not NAME=DRONE,..., such as alice=red,green")
        if name in found:
            raise CannotMake(f"--operator names {name} twice")
        found[_name(name, "--operator")] = [_name(drone, "--operator") for drone in flown.split(",")]
    return found


if __name__ == "__main__":
    sys.exit(main())
