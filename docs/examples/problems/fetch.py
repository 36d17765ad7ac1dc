"""Fetches published problems and lays them out as the files in configs/ expect them.

    python docs/examples/problems/fetch.py               # all three sets, into ../shared/data
    python docs/examples/problems/fetch.py liao2019 --to FOLDER

Sets:

* ``liao2019``: the 121 problems of Liao et al. (haiguanl/DQN_GlobalRouting, MIT);
* ``ispd98``: ibm01 of the ISPD'98 benchmarks, as UTDA-group/BoxRouter (Apache-2.0) has it;
* ``ispd18``: test1 of the ISPD 2018 contest, LEF and DEF.

Every file is compared with a known SHA-256 digest. This is the only file of the project that
fetches anything.
"""

import argparse
import csv
import hashlib
import io
import sys
import tarfile
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
RESULTS = ROOT / "docs" / "results" / "liao2019.csv"  # published and optimal figures
DIGESTS = ROOT / "docs" / "results" / "published_problems.sha256"
URLS = {
    "liao2019": "https://github.com/haiguanl/DQN_GlobalRouting/archive/HEAD.zip",
    "ispd98": "https://raw.githubusercontent.com/UTDA-group/BoxRouter/HEAD/"
    "br_64bit_release/bench/ibm01.modified.txt",
    "ispd18": "http://www.ispd.cc/contests/18/ispd18_test1.tgz",
}


def known(name: str) -> dict[str, str]:
    """The digests of a set's files, by their paths."""
    lines = (line.split() for line in DIGESTS.read_text(encoding="utf-8").splitlines())
    return {path: digest for digest, path in lines if path.startswith(f"{name}/")}


def members(name: str, data: bytes) -> Iterator[bytes]:
    """The files in what was fetched."""
    if name == "liao2019":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for member in archive.namelist():
                if member.endswith(".gr"):
                    yield archive.read(member)
    elif name == "ispd18":
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            for member in archive:
                if member.isfile() and (file := archive.extractfile(member)):
                    yield file.read()
    else:
        yield data


def published(folder: Path) -> None:
    """Writes results.csv: overflow and wirelength of the authors' routes, and the optimum."""
    columns = {"authors-dqn": "drl", "authors-astar": "astar", "optimal": "optimal"}
    table: dict[tuple[str, str], dict[str, str]] = {}
    with RESULTS.open(encoding="utf-8", newline="") as lines:
        for row in csv.DictReader(lines):
            if (column := columns.get(row["router"])) is not None:
                problem = table.setdefault((row["set"], row["problem"]), {})
                problem[f"{column}_overflow"] = row["overflow"]
                problem[f"{column}_wirelength"] = row["wirelength"]
    rows = [{"set": s, "problem": p, **figures} for (s, p), figures in table.items()]
    with (folder / "results.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def fetch(name: str, to: Path) -> None:
    """Fetches a set and writes its files."""
    print(f"{name}: fetching {URLS[name]} ...", file=sys.stderr)
    try:
        with urllib.request.urlopen(URLS[name]) as answer:
            data = answer.read()
    except OSError as error:
        sys.exit(f"{name}: {URLS[name]}: {error}")
    found = {hashlib.sha256(file).hexdigest(): file for file in members(name, data)}
    wanted = known(name)
    if missing := [path for path, digest in wanted.items() if digest not in found]:
        sys.exit(
            f"{name}: {len(missing)} of {len(wanted)} files have changed, such as {missing[0]}"
        )
    for path, digest in wanted.items():
        (to / path).parent.mkdir(parents=True, exist_ok=True)
        (to / path).write_bytes(found[digest])
    if name == "liao2019":
        published(to / name)
    print(f"{name}: {len(wanted)} files in {to / name}", file=sys.stderr)


def main() -> None:
    """Reads the command line and fetches."""
    parser = argparse.ArgumentParser(description="Fetches published problems.")
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"{', '.join(URLS)}; default: all")
    parser.add_argument("--to", type=Path, default=ROOT.parent / "shared" / "data")
    chosen = parser.parse_args()
    for name in chosen.sets or URLS:
        if name not in URLS:
            parser.error(f"SET: expected one of {', '.join(URLS)}, found {name}")
        fetch(name, chosen.to)


if __name__ == "__main__":
    main()
