"""Scripts by which shells complete the command line: plain text, made from `commands` and the bundled cases, so that a
press of the Tab key starts no Python."""

from string import Template

from pdpetsc import catalogue
from pdpetsc.commands import COMMANDS, LISTS, OPTIONS, SHELLS

BASH = Template(
    """\
# Completion of pdpetsc in bash; written by: pdpetsc completion bash
_pdpetsc() {
    # Words as the user sees them: bash cuts them at colons and equal signs.
    local line="$${COMP_LINE:0:COMP_POINT}" word command=run previous="" files="" words=""
    local -a said
    read -ra said <<< "$$line"
    [[ "$$line" == *[[:space:]] ]] && said+=("")
    local current="$${said[-1]}"
    (($${#said[@]} > 1)) && previous="$${said[-2]}"
    (($${#said[@]} == 2)) && command=first
    for word in "$${said[@]:1:$${#said[@]}-2}"; do
        case "$$word" in $commands) command="$$word"; break;; esac
    done
    case "$$previous" in
$values
        *) case "$$command:$$current" in
$options
$operands
        esac;;
    esac
    COMPREPLY=($$(compgen -W "$$words" -- "$$current"))
    case "$$files" in
        cases) COMPREPLY+=($$(compgen -f -X '!*.toml' -- "$$current") $$(compgen -d -S / -- "$$current"));;
        folders) COMPREPLY+=($$(compgen -d -S / -- "$$current"));;
    esac
    [[ "$${COMPREPLY[*]}" == */ ]] && compopt -o nospace 2> /dev/null
    case "$$current" in  # what stands before the last colon is another word to bash
        *:*) [[ "$$COMP_WORDBREAKS" == *:* ]] && COMPREPLY=("$${COMPREPLY[@]#"$${current%:*}:"}");;
    esac
}
complete -F _pdpetsc pdpetsc
"""
)

ZSH = Template("""\
#compdef pdpetsc
# Completion of pdpetsc in zsh; written by: pdpetsc completion zsh > DIRECTORY_IN_FPATH/_pdpetsc
_pdpetsc() {
    local word command=run previous="$${words[CURRENT-1]}" current="$${words[CURRENT]}"
    ((CURRENT == 2)) && command=first
    for word in "$${(@)words[2,CURRENT-1]}"; do
        case "$$word" in $commands) command="$$word"; break;; esac
    done
    case "$$previous" in
$values
        *) case "$$command:$$current" in
$options
$operands
        esac;;
    esac
}
if [[ "$${funcstack[1]}" == _pdpetsc ]]; then _pdpetsc "$$@"; else compdef _pdpetsc pdpetsc; fi
""")


def script(shell: str) -> str:
    """Return the script of one of `commands.SHELLS`."""
    places = _places()
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](places).rstrip("\n")


Places = dict[str, tuple[list[str], str]]
"""Where a word may stand, first of all or after a command: what it may be, and the kind of files."""


def _places() -> Places:
    names = []
    for name, document in catalogue.documents().items():
        names += [name, *(f"{name}:{variant}" for variant in document.get("variant", {}))]
    words = {"run": names, "check": names, "list": [*LISTS, *names], "completion": [*SHELLS]}
    files = {"restart": "folders", "plot": "folders", "schema": "", "completion": ""}
    after = {command: (words.get(command, []), files.get(command, "cases")) for command in COMMANDS}
    return {"first": ([*COMMANDS, *names], "cases")} | after


def _options(place: str) -> list[str]:
    command = "run" if place == "first" else place
    return [*(name for name, about in OPTIONS.items() if command in about.commands), "--help", "--version"]


def _bash(places: Places) -> str:
    values = {name: f'words="{" ".join(about.choices)}"' for name, about in OPTIONS.items() if about.value}
    values["--out"] = "files=folders"
    return BASH.substitute(
        commands="|".join(COMMANDS),
        values=_branches(values),
        options=_branches({f"{command}:-*": f'words="{" ".join(_options(command))}"' for command in places}),
        operands=_branches(
            {f"{place}:*": f'words="{" ".join(words)}" files="{kind}"' for place, (words, kind) in places.items()}
        ),
    )


def _zsh(places: Places) -> str:
    files = {"cases": '; _files -g "*.toml"', "folders": "; _files -/", "": ""}
    values = {name: f"compadd -- {' '.join(about.choices)}" for name, about in OPTIONS.items() if about.value}
    values["--out"] = "_files -/"
    return ZSH.substitute(
        commands="|".join(COMMANDS),
        values=_branches(values),
        options=_branches({f"{command}:-*": f"compadd -- {' '.join(_options(command))}" for command in places}),
        operands=_branches(
            {f"{place}:*": f"compadd -- {' '.join(words)}{files[kind]}" for place, (words, kind) in places.items()}
        ),
    )


def _branches(actions: dict[str, str]) -> str:
    """Of a `case` of the shell."""
    return "\n".join(f"            {pattern}) {action};;" for pattern, action in actions.items())


def _fish(places: Places) -> str:
    """fish asks by itself for files where `-f` does not forbid it."""
    lines = ["# Completion of pdpetsc in fish; written by: pdpetsc completion fish", "complete -c pdpetsc -f"]
    every = " ".join(COMMANDS)
    none = f"not __fish_seen_subcommand_from {every}"
    for command, about in COMMANDS.items():
        lines.append(f"complete -c pdpetsc -n '{none}' -a {command} -d '{_plain(about.meaning)}'")
    for command in COMMANDS:
        here = f"{none}; or __fish_seen_subcommand_from run" if command == "run" else _seen(command)
        words, files = places[command]
        words = [word for word in words if word not in COMMANDS]
        if words:
            lines.append(f"complete -c pdpetsc -n '{here}' -a '{' '.join(words)}'")
        if files:
            function = "__fish_complete_directories" if files == "folders" else "__fish_complete_suffix .toml"
            lines.append(f"complete -c pdpetsc -n '{here}' -a '({function})'")
    for name, option in OPTIONS.items():
        where = "; or ".join(_seen(c) for c in option.commands) + (f"; or {none}" if "run" in option.commands else "")
        value = f" -x -a '{' '.join(option.choices)}'" if option.value else ""
        value = " -r -a '(__fish_complete_directories)'" if name == "--out" else value
        lines.append(f"complete -c pdpetsc -n '{where}' -l {name[2:]}{value} -d '{_plain(option.meaning)}'")
    lines += [
        "complete -c pdpetsc -l help -s h -d 'print help'",
        "complete -c pdpetsc -l version -d 'print the version'",
    ]
    return "\n".join(lines)


def _seen(command: str) -> str:
    return f"__fish_seen_subcommand_from {command}"


def _plain(text: str) -> str:
    return text.replace("'", "’")
