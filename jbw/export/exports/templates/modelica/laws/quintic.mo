{% if part == "equations" %}
  force_quintic = quintic*s_rel^5;
{% endif %}
