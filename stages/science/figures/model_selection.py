"""What evidence there is for each input of the models."""

import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure


def draw_selection(inputs: pd.DataFrame) -> Figure:
    """Draw the log evidence for how each input was decided on; rows are of the table `selected_inputs`."""
    figure, ((axes,),) = new_figure(6.4, 0.42 * len(inputs) + 1.1)
    names = [name.replace("_", " ") for name in inputs["input"]]
    for selected, label, colour in ((True, "selected", COLOURS[0]), (False, "left out", COLOURS[2])):
        own = (inputs["selected"] == selected).to_numpy()
        if not own.any():
            continue
        axes.barh(
            [name for name, its in zip(names, own, strict=True) if its],
            inputs.loc[own, "evidence"],
            0.6,
            color=colour,
            label=label,
        )
    axes.set_yticks(names, names)
    axes.invert_yaxis()
    axes.set_xlabel("log evidence for this decision (nats)")
    axes.grid(alpha=0.25, axis="x")
    axes.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure
