"""Every pydantic model of the project can be used as soon as its module is imported."""

from __future__ import annotations

import inspect
import pkgutil
from importlib import import_module

import pytest
from pydantic import BaseModel

import schemas
import services

MODULES = sorted(
    module.name
    for package in (schemas, services)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    if not module.name.endswith("__main__")
)


@pytest.mark.parametrize("name", MODULES)
def test_the_models_of_a_module_know_the_types_of_their_fields(name: str) -> None:
    """A type that is imported for type checking only leaves a model that fails at its first use."""
    models = [
        found
        for found in vars(import_module(name)).values()
        if inspect.isclass(found) and issubclass(found, BaseModel) and found.__module__ == name
    ]
    assert [model.__name__ for model in models if not model.__pydantic_complete__] == []
