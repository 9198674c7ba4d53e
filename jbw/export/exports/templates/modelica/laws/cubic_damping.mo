{% if part == "equations" %}
  force_cubic_damping = cubic_damping*v_rel^3;
{% endif %}
