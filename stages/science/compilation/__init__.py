"""Where compiled functions are kept between processes, and what makes a kept one stale."""
