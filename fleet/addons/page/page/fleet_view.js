// The adapter between NiceGUI and the modules, which know no toolkit: they get a model and an element.
import { Model, render } from "fleet-view";

export default {
  template: "<div class='fleet-view'></div>",
  props: { setup: Object },
  mounted() {
    document.documentElement.lang = "en";
    this.model = new Model({ setup: this.setup }, (message) => this.$emit("say", message));
    this.end = render({ model: this.model, el: this.$el });
  },
  unmounted() {
    this.end();
  },
  methods: {
    give(changes) {
      for (const [key, value] of Object.entries(changes)) this.model.set(key, value);
    },
  },
};
