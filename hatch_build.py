"""Puts compiled code into a wheel for this platform (`make wheel`); without RICOCHET_COMPILED the wheel is pure."""

import os
import sys
import sysconfig
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledCode(BuildHookInterface[Any]):
    """Adds the folder that RICOCHET_COMPILED names, and the version of numba whose code it is."""

    def initialize(self, version_of_build: str, build_data: dict[str, Any]) -> None:
        """Change what goes into the wheel; an editable installation stays as it is.

        Raises
        ------
        FileNotFoundError
            If the folder holds no compiled code.
        """
        folder = os.environ.get("RICOCHET_COMPILED")
        if not folder or version_of_build == "editable":
            return
        if not any(Path(folder).rglob("*.nbc")):
            raise FileNotFoundError(
                f"RICOCHET_COMPILED names {folder}, which holds no compiled code; on x86-64 that takes AVX2"
            )
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        system = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"{python}-{python}-{system}"
        build_data["pure_python"] = False
        build_data["force_include"][folder] = "solver/compiled"
        build_data["dependencies"].append(f"numba=={version('numba')}")
