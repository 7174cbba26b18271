"""The options of `slicemask train` are its settings: they cannot differ."""

import subprocess
import sys
from dataclasses import fields

import click
import pytest
from click.testing import CliRunner
from slicematch.data import DATA_SETS, config_class
from slicematch.runs.config import TrainConfig
from slicematch.runs.settings import documentation

from slicemask.cli.setting_options import given_settings, setting_options
from slicemask.cli.train import train

NOT_SETTINGS = {"config_file", "recipe", "out", "resume", "cache", "as_json", "help"}
OPTIONS = {option.name: option for option in train.params if option.name not in NOT_SETTINGS}


def test_every_setting_is_an_option_and_every_option_a_setting():
    shared = {
        field.name for field in fields(TrainConfig) if field.metadata.get("option", "") is not None
    }
    own = {name for data in DATA_SETS for name in config_class(data).own_settings()}
    assert set(OPTIONS) == shared | own
    assert own == {
        *("labels", "cities", "split_dir"),
        *("side_m", "view", "shift_m", "map", "map_crs"),
    }


def test_every_setting_is_documented():
    for kind in (TrainConfig, *map(config_class, DATA_SETS)):
        documented = documentation(kind)
        own = kind.own_settings() if hasattr(kind, "own_settings") else None
        for field in fields(kind):
            if own is None or field.name in own:
                assert documented[field.name][1]


def test_the_help_shows_the_defaults_of_the_settings():
    for field in fields(TrainConfig):
        option = OPTIONS.get(field.name)
        required = field.name in TrainConfig.required
        if option is None or required or field.default is None:
            continue
        shown = option.help.rsplit("[default: ", 1)[1].rstrip("]")
        if field.default == ():
            assert shown == "none"
        elif isinstance(field.default, bool):
            assert shown == {True: "yes", False: "no"}[field.default]
        else:
            assert type(field.default)(shown) == field.default
    for name in ("train_grid", "test_grid", "ground_size"):
        for data in DATA_SETS:
            value = getattr(TrainConfig(data=data, root="x"), name)
            text = value if isinstance(value, str) else ",".join(map(str, value))
            assert f"{text} for {data}" in OPTIONS[name].help


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        (["--data", "kitti", "--split", "cross-area"], {"data": "kitti", "split": "cross-area"}),
        (["--heading-prior", "20"], {"heading_half_width_deg": 20.0}),
        (["--heading-prior", "any"], {"heading_half_width_deg": None}),
        (["--alpha", "K"], {"alpha": None}),
        (["--alpha", "2"], {"alpha": 2.0}),
        (["--cities", "Chicago,Seattle"], {"cities": ["Chicago", "Seattle"]}),
        (["--ground-size", "32,64"], {"ground_size": (32, 64)}),
        (["--place-prior", "0.5,0.5,0.2"], {"place_prior": (0.5, 0.5, 0.2)}),
        (
            ["--no-cross-view-attention", "--augment"],
            {"cross_view_attention": False, "augment": True},
        ),
        (["--labels", "splits_new", "--hfov", "360"], {"labels": "splits_new", "hfov_deg": 360.0}),
        ([], {}),
    ],
)
def test_what_is_typed_becomes_settings(arguments, settings):
    found = {}

    @click.command()
    @setting_options
    def command(**options):
        found.update(given_settings(options))

    result = CliRunner().invoke(command, arguments)
    assert result.exit_code == 0, result.output
    assert found == settings


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--data", "cvusa"], "'cvusa' is not one of 'vigor', 'kitti', 'table'"),
        (["--alpha", "many"], "'many' is neither a float nor K"),
        (["--ground-size", "32"], "'32' is not height,width"),
        (["--precision", "8"], "'8' is not one of '32-true'"),
    ],
)
def test_what_is_mistyped_is_refused(arguments, said):
    result = CliRunner().invoke(train, arguments)
    assert result.exit_code == 2
    assert said in result.output


def test_the_help_takes_neither_torch_nor_the_packages_of_the_model():
    code = (
        "import sys; sys.modules.update(dict.fromkeys(('torch', 'yaml', 'lightning', 'timm')));"
        "from slicemask.cli.main import main; main(['train', '--help'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "--heading-prior" in done.stdout
