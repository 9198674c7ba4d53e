{% if part == "equations" %}
  force_cubic = cubic*s_rel^3;
{% endif %}
