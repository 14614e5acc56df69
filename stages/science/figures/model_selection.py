"""What evidence there is for each input of the models."""

import pandas as pd

from stages.science.figures.canvas import COLOURS, Figure, new_figure


def draw_selection(inputs: pd.DataFrame) -> Figure:
    """Draw the log evidence for how each input was decided on; rows are of the table `selected_inputs`."""
    figure, ((axes,),) = new_figure(6.4, 0.42 * len(inputs) + 1.1, grid="x")
    names = inputs["input"].str.replace("_", " ")
    for selected, label, colour in ((True, "selected", COLOURS[0]), (False, "left out", COLOURS[2])):
        own = inputs["selected"] == selected
        if own.any():
            axes.barh(list(names[own]), inputs.loc[own, "evidence"], 0.6, color=colour, label=label)
    axes.set_yticks(list(names), list(names))
    axes.invert_yaxis()
    axes.set_xlabel("log evidence for this decision (nats)")
    axes.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure
