"""Write down, and later check, the SHA-256 of a key.

    python seal.py KEY.json SEAL_FILE            # write the seal; commit that file before the tool runs
    python seal.py KEY.json SEAL_FILE --check    # exit code 2 when the key is not the sealed one
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path


def sha256(path):
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def seal(key, target):
    """Write the hash of `key` into `target` and return it."""
    value = sha256(key)
    Path(target).write_text(f"{value}  {Path(key).name}\n", encoding="utf-8")
    return value


def check(key, target):
    """Return the hash of `key`; raise ValueError when it is not the one in `target`."""
    value = sha256(key)
    sealed = Path(target).read_text(encoding="utf-8").split()[0]
    if value != sealed:
        raise ValueError(f"{key}: SHA-256 is {value}, sealed was {sealed}; score the key that was sealed")
    return value


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("key", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args(argv)
    try:
        value = check(args.key, args.target) if args.check else seal(args.key, args.target)
    except (OSError, ValueError) as failure:
        print(failure, file=sys.stderr)
        return 2
    print(value)
    return 0


if __name__ == "__main__":
    sys.exit(main())
