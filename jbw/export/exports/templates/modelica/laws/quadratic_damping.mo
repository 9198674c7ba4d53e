{% if part == "equations" %}
  force_quadratic_damping = quadratic_damping*v_rel*abs(v_rel);
{% endif %}
