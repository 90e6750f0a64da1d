.class Ldressi/sample/MainActivity$1;
.super Ljava/lang/Object;

# interfaces
.implements Landroid/view/View$OnClickListener;


# annotations
.annotation system Ldalvik/annotation/EnclosingMethod;
    value = Ldressi/sample/MainActivity;->onCreate(Landroid/os/Bundle;)V
.end annotation

.annotation system Ldalvik/annotation/InnerClass;
    accessFlags = 0x0
    name = null
.end annotation


# instance fields
.field final synthetic this$0:Ldressi/sample/MainActivity;


# direct methods
.method constructor <init>(Ldressi/sample/MainActivity;)V
    .registers 2

    iput-object p1, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    return-void
.end method


# virtual methods
.method public onClick(Landroid/view/View;)V
    .registers 4

    iget-object v1, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    iget-object v0, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->paused:Z
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$000(Ldressi/sample/MainActivity;)Z

    move-result v0

    if-nez v0, :cond_26

    const/4 v0, 0x1

    :goto_b
    # setter for: Ldressi/sample/MainActivity;->paused:Z
    invoke-static {v1, v0}, Ldressi/sample/MainActivity;->access$002(Ldressi/sample/MainActivity;Z)Z

    iget-object v0, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$100(Ldressi/sample/MainActivity;)Ldressi/sample/Worker;

    move-result-object v0

    if-eqz v0, :cond_25

    iget-object v0, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->worker:Ldressi/sample/Worker;
    invoke-static {v0}, Ldressi/sample/MainActivity;->access$100(Ldressi/sample/MainActivity;)Ldressi/sample/Worker;

    move-result-object v0

    iget-object v1, p0, Ldressi/sample/MainActivity$1;->this$0:Ldressi/sample/MainActivity;

    # getter for: Ldressi/sample/MainActivity;->paused:Z
    invoke-static {v1}, Ldressi/sample/MainActivity;->access$000(Ldressi/sample/MainActivity;)Z

    move-result v1

    invoke-virtual {v0, v1}, Ldressi/sample/Worker;->pause(Z)V

    :cond_25
    return-void

    :cond_26
    const/4 v0, 0x0

    goto :goto_b
.end method
