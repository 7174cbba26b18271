import subprocess
import sys


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_model_is_made_and_runs_without_the_compiler():
    assert _run(
        "import sys, torch\n"
        "from slicematch._deferred_compiler import defer_compiler\n"
        "defer_compiler()\n"
        "from slicematch.network.slicematch import SliceMatch\n"
        "model = SliceMatch('test_resnet', 'none', (32, 64), 32, 16, 4).eval()\n"
        "model.encode_ground(torch.zeros(1, 3, 32, 64))\n"
        "print([name for name in sys.modules if name.startswith('torch._dynamo.')])\n"
    ) == ("['torch._dynamo.utils']")


def test_it_is_there_once_it_is_asked_for():
    code = (
        "import torch\n"
        "from slicematch._deferred_compiler import defer_compiler\n"
        "defer_compiler()\n"
        "import timm  # noqa\n"
        "compiled = torch.compile(lambda x: x + 1, backend='eager')\n"
        "print(compiled(torch.ones(1)).item(), torch._dynamo.config.cache_size_limit > 0)\n"
    ).replace("import timm", "from slicematch import _torchvision; import timm")
    assert _run(code) == "2.0 True"


def test_a_compiler_that_is_there_stays():
    assert (
        _run(
            "import torch._dynamo as real, sys\n"
            "from slicematch._deferred_compiler import defer_compiler\n"
            "defer_compiler()\n"
            "print(sys.modules['torch._dynamo'] is real)\n"
        )
        == "True"
    )
