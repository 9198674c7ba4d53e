{% if part == "equations" %}
  force_square = square*s_rel^2;
{% endif %}
