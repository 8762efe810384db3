"""Parameters of the operator's page."""

from dataclasses import dataclass

from omm_core.alignment.controls import CONTROLS
from omm_report.language import LANGUAGES
from omm_ros.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """See docs/operator.md."""

    port: int = parameter(
        8765, "Port of the page; 0 takes any that is free.", minimum=0, maximum=65535
    )
    address: str = parameter(
        "127.0.0.1",
        "Address to listen at. Only this computer reaches 127.0.0.1; others need a one-time token, "
        "which the node tells in its log.",
    )
    hosts: tuple[str, ...] = parameter(
        (), "Names by which other computers call this one, without port; all others are refused."
    )
    tls_certificate_file: str = parameter("", "Certificate (PEM) of the page; with it, https.")
    tls_key_file: str = parameter("", "The certificate's private key (PEM).")
    language: str = parameter(
        "en", "Language of the page until somebody chooses another.", choices=LANGUAGES
    )
    part_file: str = parameter(
        "", "Part file with tolerances, nominal pose and jacks; empty: the estimator's."
    )
    machine_file: str = parameter("", "machine.yaml that says where up is; empty: along machine Z.")
    stops: int = parameter(
        0, "Images that the measuring program takes; 0: learned from its first run.", minimum=0
    )
    control: str = parameter(
        "",
        "Control in whose words the pose is told; empty: that of the CNC bridge.",
        choices=("", *CONTROLS),
    )
    offset: str = parameter(
        "", "Work offset (or preset) that is handed over to; empty: the control's first."
    )
    remaining_mm: float = parameter(
        0.1, "What a corner of the part's box may be off by in the control's words.", minimum=0.0
    )
    fresh_s: float = parameter(
        3600.0, "An estimate older than this is not handed over.", minimum=1.0
    )
