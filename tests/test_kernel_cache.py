"""A helper that changes in one file must reach the kernels of another that it was compiled into."""

import os
import subprocess
import sys
import textwrap
import time

from pwaid._kernel_cache import drop_stale

MODULES = {
    "helper.py": "import numba\n\n\n@numba.njit(cache=True)\ndef twice(x):\n    return {factor} * x\n",
    "user.py": textwrap.dedent("""\
        import sys
        from pathlib import Path

        import numba

        from package.helper import twice


        @numba.njit(cache=True)
        def apply(x):
            return twice(x) + 1


        print(apply(10))
        """),
}


def write(folder, factor):
    folder.mkdir(exist_ok=True)
    (folder / "__init__.py").touch()
    for name, text in MODULES.items():
        if name != "user.py" or not (folder / name).exists():
            (folder / name).write_text(text.format(factor=factor) if name == "helper.py" else text, encoding="utf-8")


def run(folder):
    done = subprocess.run([sys.executable, "-m", "package.user"], cwd=folder.parent, capture_output=True, text=True,
                          check=True, env={**os.environ, "NUMBA_CACHE_DIR": ""})
    return int(done.stdout)


def test_a_changed_helper_reaches_the_kernels_that_hold_it(tmp_path):
    folder = tmp_path / "package"
    write(folder, 2)
    assert run(folder) == 21
    time.sleep(0.02)
    write(folder, 3)
    assert run(folder) == 21  # what numba alone does; when this fails, the module under test can go
    write(folder, 3)
    assert drop_stale(folder) == 2
    assert run(folder) == 31
    assert drop_stale(folder) == 0


def test_a_date_ahead_of_the_clock_does_not_empty_the_cache_every_time(tmp_path):
    folder = tmp_path / "package"
    write(folder, 2)
    run(folder)
    ahead = time.time() + 1e6
    os.utime(folder / "helper.py", (ahead, ahead))
    assert drop_stale(folder) == 0


def test_another_process_may_remove_what_is_looked_at(tmp_path, monkeypatch):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    (tmp_path / "kernels.py").touch()
    indices = [cache / f"kernels.f{k}.nbi" for k in range(2)]
    for index in indices:
        index.touch()
        os.utime(index, ns=(1, 1))
    listed = type(tmp_path).rglob
    monkeypatch.setattr(type(tmp_path), "rglob", lambda self, pattern: [*listed(self, pattern), cache / "gone.g.nbi"])
    assert drop_stale(tmp_path) == 2
    assert not any(index.exists() for index in indices)
