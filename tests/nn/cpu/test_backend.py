"""Choices that depend on the backend and on the CPU's features."""

import pytest

from scjax.nn.cpu.backend import attention_parts, bfloat16_is_faster, cpu_flags, on_cpu, scenes_at_once

CPUS = [
    ("AuthenticAMD", "fma avx512f avx512_bf16", True),
    ("GenuineIntel", "fma avx512f avx512_bf16", False),
    ("GenuineIntel", "avx512_bf16 amx_tile amx_bf16", True),
    ("AuthenticAMD", "fma avx512f", False),
    ("GenuineIntel", "", False),
]


@pytest.fixture
def cpuinfo(tmp_path):
    """Writes a file like /proc/cpuinfo of two processors and returns its path."""

    def write(vendor, flags):
        path = tmp_path / "cpuinfo"
        path.write_text(
            f"processor\t: 0\nvendor_id\t: {vendor}\nflags\t\t: {flags}\n\nprocessor\t: 1\nflags\t\t: {flags}\n"
        )
        return str(path)

    return write


@pytest.mark.parametrize("vendor, flags, faster", CPUS)
def test_bfloat16_is_faster_depends_on_cpu_flags(vendor, flags, faster, cpuinfo):
    assert bfloat16_is_faster("cpu", cpuinfo(vendor, flags)) == faster


@pytest.mark.parametrize("backend", ["gpu", "tpu"])
def test_bfloat16_is_faster_on_accelerators(backend, cpuinfo):
    assert bfloat16_is_faster(backend, cpuinfo("GenuineIntel", ""))


@pytest.mark.parametrize("vendor, flags, _", CPUS)
def test_cpu_flags_reads_first_processor(vendor, flags, _, cpuinfo):
    assert cpu_flags(cpuinfo(vendor, flags)) == set(flags.split())


def test_cpu_flags_are_empty_without_linux(tmp_path):
    assert cpu_flags(str(tmp_path / "none")) == frozenset()


@pytest.mark.parametrize("batch_size", [1, 16, 64])
def test_scenes_at_once_is_bounded_on_cpu_only(batch_size):
    assert scenes_at_once(batch_size) == (16 if on_cpu() else batch_size)


@pytest.mark.parametrize("scenes, scores, parts", [(8, 10, 1), (8, 10**6, 4), (6, 10**6, 2), (4, 10**8, 4)])
def test_attention_parts_keep_scores_in_cache(scenes, scores, parts):
    assert attention_parts(scenes, scores) == (parts if on_cpu() else 1)
