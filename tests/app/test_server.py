"""What the server gives away, and what it refuses."""

import http.client
import subprocess
import sys
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from slicemask.app.uploads import MOST_BYTES, ImageDropper, read_upload
from slicemask.cli.main import main
from slicemask.errors import ImageError


def _get(url, path):
    connection = http.client.HTTPConnection(url.removeprefix("http://"), timeout=30)
    connection.request("GET", path)  # as it is: nothing resolves the dots before
    answer = connection.getresponse()
    return answer.status, answer.read()


@pytest.mark.parametrize(
    "path",
    [
        "/etc/passwd",
        "/static/../../../../../../etc/passwd",
        "/static/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/static/extensions/panel/../../../../../../../../../etc/passwd",
        "/components/panel.widgets.base/Widget/__init__/../../../etc/passwd",
        "/slicemask/app/tile.jpg",
        "/pyproject.toml",
    ],
)
def test_no_path_of_the_server_can_be_asked_for(explorer, path):
    status, content = _get(explorer, path)
    assert status >= 400
    assert b"root:" not in content


def test_only_this_computer_is_served_unless_told_otherwise(explorer):
    assert explorer.startswith("http://127.0.0.1:")
    assert _get(explorer, "/")[0] == 200


def test_a_port_in_use_is_one_sentence(explorer):
    port = explorer.rpartition(":")[2]
    done = CliRunner().invoke(main, ["app", "--no-browser", "--port", port])
    assert done.exit_code == 1
    assert f"port {port} of 127.0.0.1 is in use" in done.output


def test_examples_without_a_run_are_refused():
    done = CliRunner().invoke(main, ["app", "--data", "somewhere"])
    assert done.exit_code == 2


def test_the_page_without_a_run_imports_no_torch():
    code = "import sys, slicemask.app.explorer, slicemask.app.serve; print('torch' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "False"


def test_an_upload_beyond_the_bound_is_refused():
    with pytest.raises(ImageError, match=r"big\.png: has 32\.0 MB"):
        read_upload(bytes(MOST_BYTES + 1), "big.png")


def test_chunks_beyond_the_bound_are_not_kept():
    dropper = ImageDropper()
    chunk = bytes(MOST_BYTES // 3)
    for number in range(1, 9):
        data = {"name": "a.png", "data": chunk, "chunk": number, "total_chunks": 9, "type": "image"}
        dropper._process_event(SimpleNamespace(event_name="upload_event", data=data))
        assert sum(map(len, dropper._file_buffer["a.png"])) <= MOST_BYTES


def test_a_file_that_claims_another_name_opens_nothing():
    with pytest.raises(ImageError, match="/etc/passwd"):
        read_upload(b"text", "/etc/passwd")
