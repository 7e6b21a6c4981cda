"""Whatever stands where a material should: a material that works, or one clear line."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nacre.core.errors import NacreError
from nacre.matter.indices.library import index
from nacre.matter.indices.spec import IndexSpec, index_spec

numbers = st.one_of(
    st.integers(), st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0, -1, 1e-308, 1e308, 10**400])
)
words = st.one_of(
    st.text(max_size=12), st.sampled_from(["Ag", "main/Ag/Johnson", "TiO3", "", "/", "//", "..", "\0", "a" * 5000])
)
leaves = st.one_of(st.none(), st.booleans(), numbers, words)
values = st.recursive(leaves, lambda v: st.lists(v, max_size=4) | st.dictionaries(words, v, max_size=3), max_leaves=6)
tables = st.dictionaries(st.sampled_from([*IndexSpec.model_fields, "zz"]), values, max_size=3)
oscillator = st.fixed_dictionaries({}, optional={"strength": numbers, "resonance_ev": numbers, "damping_ev": numbers})
models = st.one_of(
    st.fixed_dictionaries({"drude": st.fixed_dictionaries({"plasma_ev": numbers}, optional={"damping_ev": numbers})}),
    st.fixed_dictionaries({"lorentz": st.fixed_dictionaries({"oscillators": st.lists(oscillator, max_size=3)})}),
    st.fixed_dictionaries({"cauchy": st.lists(numbers, max_size=4)}),
    st.fixed_dictionaries({"sellmeier": st.lists(numbers, max_size=6)}),
    st.fixed_dictionaries({"n_d": numbers, "abbe": numbers}),
    st.fixed_dictionaries({"n": numbers}, optional={"k": numbers}),
)


@settings(max_examples=600, deadline=None, derandomize=True)
@given(st.one_of(values, tables, models))
def test_anything_is_a_material_or_one_clear_line(data):
    try:
        constant = index_spec(data).build()
        n = constant.n_complex(np.linspace(400.0, 800.0, 9))
    except NacreError as error:
        assert "\n" not in str(error) and len(str(error)) < 600
    else:
        assert np.isfinite(n).all() and (n.imag >= 0).all() and (n.real >= 0).all()


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.one_of(words, st.floats(), st.complex_numbers(), tables))
def test_index_takes_anything_with_one_clear_line(data):
    try:
        index(data).n_complex([550.0])
    except NacreError as error:
        assert "\n" not in str(error)
