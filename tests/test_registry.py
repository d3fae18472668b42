import pytest

from lpvmpc.control import registry
from lpvmpc.control.rivals import RIVALS, Rival
from lpvmpc.errors import ControllerError
from lpvmpc.sim.names import load_controller


def test_a_rival_without_its_package_says_how_to_install_it(monkeypatch):
    rival = Rival(module="nmpc", maker="NMPC", packages=("json", "no_such_solver"), extra="nmpc")
    monkeypatch.setitem(RIVALS, "far", rival)
    monkeypatch.setitem(registry.CONTROLLERS, "far", ("rivals.nmpc", "NMPC"))
    with pytest.raises(ControllerError, match=r"'far' needs the package no_such_solver; .*nmpc\]"):
        load_controller("far")


def test_the_core_holds_no_rival():
    assert registry.CORE[0] == "lpv-mpc" and not set(registry.CORE) & set(RIVALS)
    assert set(registry.CONTROLLERS) == {*registry.CORE, *RIVALS}
