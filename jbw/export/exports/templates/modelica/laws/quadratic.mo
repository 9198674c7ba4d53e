{% if part == "equations" %}
  force_quadratic = quadratic*s_rel*abs(s_rel);
{% endif %}
