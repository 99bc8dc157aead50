"""What holds for all tests."""

import pytest
from hypothesis import HealthCheck, settings

pytest_plugins = ["in_process_runs"]

# Property tests are about laws, not about how fast the machine is that checks them.
settings.register_profile("laws", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("laws")


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Several workers (`-n`) get whole stretches of the tests, so that those of a module share what they set up."""
    if getattr(config.option, "numprocesses", None) and config.option.dist in ("no", "load"):
        config.option.dist = "worksteal"
