#!/usr/bin/env -S uv run
# /// script
# dependencies = ["nox>=2025.2.9"]
# ///
"""Tasks of contributors: ``nox -l`` lists them, ``nox -s lint`` runs one."""

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "venv"


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests; arguments after ``--`` go to pytest."""
    session.install("-e", ".[test]")
    chosen = session.posargs or ["-n", "auto", "--dist", "worksteal"]
    session.run("python", "-m", "pytest", *chosen, env={"OPENBLAS_NUM_THREADS": "1"})


@nox.session
def lint(session: nox.Session) -> None:
    """Check style and form of the code."""
    session.install("ruff")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Check the types."""
    session.install("-e", ".[test]")
    session.run("mypy")


@nox.session
def layers(session: nox.Session) -> None:
    """Check that modules import only from below."""
    session.install("-e", ".[test]")
    session.run("lint-imports")


@nox.session(default=False)
def site(session: nox.Session) -> None:
    """Build the documentation into out/site."""
    session.install("-e", ".[docs]")
    session.run("python", "-m", "sphinx", "-W", "--keep-going", "-b", "html", "docs", "out/site")


@nox.session(default=False)
def report(session: nox.Session) -> None:
    """Run a validation report: ``nox -s report -- pendulum``."""
    session.install("-e", ".")
    session.run("python", "-m", "validation", "run", *session.posargs)


@nox.session(default=False)
def benchmarks(session: nox.Session) -> None:
    """Keep the speed of the newest commit beside earlier ones, in out/asv: ``asv publish``."""
    session.install("asv>=0.6", "virtualenv")
    session.run("asv", "machine", "--yes")
    session.run("asv", *(session.posargs or ["run"]))


@nox.session(default=False)
def wheels(session: nox.Session) -> None:
    """Build and test the wheels of this system into out/wheels."""
    session.run("bash", ".ci/wheels", external=True)


if __name__ == "__main__":
    nox.main()
